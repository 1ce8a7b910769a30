"""A net as a functional mock-up unit (FMU): co-simulation by FMI 2.0 or 3.0.

The FMU's binary is a small C library that keeps the values of the variables. The net is in a process of its
own, the worker, which the library starts and speaks to over a socket (`worker`); so the host's process has no
Python. Each module has one task: `variables` and `units` say what a variable is, `parameters` and `signals`
which of them a case has, `served` what becomes of their values, `description` and `export` write the file.
"""

"""A net as a functional mock-up unit (FMU): co-simulation by FMI 2.0 or 3.0.

The FMU's binary is a small C library that keeps the values of the variables; the net is in a process of its own,
the worker, which the library starts and speaks to over a socket (`worker`). So the host's process has no Python.
"""

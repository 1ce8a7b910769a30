"""Net as a functional mock-up unit (FMU): co-simulation by FMI 2.0 or 3.0.

The FMU's binary is a small C library that stores the values of the variables. The net is in a process of its
own, the worker, which the library starts and which it asks over a socket; so the host's process has no
Python. `variables` defines variables, units, parameters and signals, `worker` serves their values, `export`
writes the file.
"""

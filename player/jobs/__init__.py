"""Jobs that do not wait for each other, and who does them: processes of this machine, or a cluster of machines.

A job is a functools.partial of an importable function and of what is small: paths, numbers, names. What is large it
reads itself. workers.py says what workers are and has this machine's; cluster.py those of dask.distributed.
May import counterlight.errors only. Read next: workers.py.
"""

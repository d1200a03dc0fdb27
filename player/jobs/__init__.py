"""Runs independent jobs, in processes of this machine or on a cluster of machines.

A job is a functools.partial of an importable function and of small arguments: paths, numbers, names. The job reads
large data itself. workers.py defines workers and this machine's workers; cluster.py defines dask.distributed's workers.
May import counterlight.errors only. Read next: workers.py.
"""

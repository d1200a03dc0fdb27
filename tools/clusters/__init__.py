"""Clusters: independent parts of the light transport, each a linear system of its own (thesis 4.2.1).

May import scipy and tools.transport. Read next: components.py.
"""

"""Clusters: independent parts of the light transport, each a separate linear system (thesis 4.2.1 to 4.2.3).

components.py labels clusters, decomposition.py cuts large ones (Appendix A), and search.py finds the cut for a given
size. connections.py holds the graph and the fit after the cut. blocks.py arranges clusters as dense blocks. May import
numpy, scipy, command, errors and tools.transport. Read next: decomposition.py.
"""

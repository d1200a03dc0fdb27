"""Clusters: independent parts of the light transport, each a linear system of its own (thesis 4.2.1 to 4.2.3).

components.py labels them, decomposition.py cuts large ones (Appendix A), search.py finds how far to cut for a given
size; connections.py is the graph, energy.py the fit after the cut, blocks.py clusters as dense blocks, jobs.py works on
them on all cores, finite.py is what is refused. May import numpy, scipy, player.{command,errors} and counterlight.tools.transport.
Read next: decomposition.py.
"""

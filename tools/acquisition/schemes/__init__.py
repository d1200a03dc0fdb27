"""Schemes, one per module: each chooses the next patterns and computes the light transport from their captures.

hierarchical.py (Sen et al. 2005) builds on blocks.py, schedule.py and agreement.py; multiplexed.py builds on the
stripes of graycode.py, which itself serves for comparison. A scheme is a generator (tools/acquisition/plan.py).
May import numpy, scipy, player, counterlight.tools.transport.
"""

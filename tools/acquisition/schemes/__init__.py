"""Which patterns to show next, and the light transport that their captures add up to: one scheme a module.

hierarchical.py (Sen et al. 2005) on blocks.py, schedule.py and agreement.py; multiplexed.py on codes.py and stripes.py;
graycode.py to compare with. A scheme is a generator (tools/acquisition/plan.py). May import numpy, scipy, player,
counterlight.tools.transport.
"""

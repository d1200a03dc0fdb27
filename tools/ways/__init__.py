"""The way by which the light of each camera pixel came, from the shape of T's rows alone (thesis 6.4).

footprints.py measures rows. bending.py tests whether they lie where straight light would. ways.py turns both into
shares of light and areas. May import numpy, scipy, OpenCV, player and tools.transport. Read next: ways.py.
"""

"""Which way the light of each camera pixel came, from T alone (thesis 6.4): what T's rows look like says it.

footprints.py measures rows, bending.py whether they lie where straight light would, ways.py makes shares of light and
areas of them. May import numpy, scipy, OpenCV, player and tools.transport. Read next: ways.py.
"""

"""One picture compensated on the CPU by the solvers of thesis 4.2.4, the reference for every claim about quality.

registry.py prepares a solver by name for one T; the solver then solves any number of pictures. box.py handles all
channels at once; direct.py, qr.py, svd.py and nnls.py handle one at a time (channel.py). clusterwise.py factors every
cluster's dense block, or iterates on larger ones. quality.py measures the camera picture; compensate.py turns
a calibration and a picture into a drive and its figures. May import numpy, scipy, scikit-image, colour-science, player
and tools.{transport,clusters,relighting}. Read next: registry.py, box.py, compensate.py.
"""

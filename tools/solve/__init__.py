"""One picture compensated on the CPU by the solvers of thesis 4.2.4, the reference for every claim about quality.

registry.py prepares a solver by its name for one T, which then solves picture after picture: box.py takes all channels
at once, direct.py, qr.py, svd.py and nnls.py one at a time (channel.py). clusterwise.py factors every cluster's dense
block, krylov.py takes what is too large for one. quality.py measures what the camera sees, compensate.py turns a
calibration and a picture into a drive and its figures.
May import numpy, scipy, scikit-image, colour-science, player and tools.{transport,clusters,relighting}.
Read next: registry.py, box.py, compensate.py.
"""

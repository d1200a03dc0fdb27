"""One picture compensated on the CPU by the solvers of thesis 4.2.4, the reference for every claim about quality.

system.py is min ‖T p − b‖ for one colour channel; direct.py, qr.py, svd.py, nnls.py and box.py solve it, registry.py
names them; clusterwise.py runs a dense solver on every cluster, krylov.py takes what is too large for one. quality.py
measures what the camera sees, compensate.py turns a calibration and a picture into a drive and its figures.
May import numpy, scipy, scikit-image, colour-science, player and tools.{transport,clusters,relighting}.
Read next: system.py, box.py, compensate.py.
"""

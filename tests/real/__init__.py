"""The benchmark of real captures: predict held-out captures, and recover pictures from captures.

`python -m tests.real FOLDER` evaluates a folder of pairs. Read folders.py, measures.py, then __main__.py.
network.py is a small network that is trained on the pairs. correction.py corrects predictions with it, and surrogate.py
recovers pictures.
"""

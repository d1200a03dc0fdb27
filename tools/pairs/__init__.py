"""Fit a room to pairs: ordinary pictures that a projector showed, and their photographs.

photographs.py reads a folder of pairs, and matching.py identifies pairs by content. geometry.py finds which projector
pixel each camera pixel sees, processing.py fits φ (code values to light), and model.py fits the rest: spread, halo,
and what is particular to each pixel. room.py writes the calibration.
May import numpy, scipy, cv2, player and the rest of tools. Read next: model.py.
"""

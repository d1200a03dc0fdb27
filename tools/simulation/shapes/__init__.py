"""Shapes that rays meet: planes and quadrics in closed form, triangles through Embree.

shape.py defines the common interface, read.py the scene file's keys. May import numpy, cv2, embreex (only triangles.py)
and counterlight.files.tables. Read next: shape.py.
"""

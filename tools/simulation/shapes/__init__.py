"""Shapes that rays meet: planes and quadrics in closed form, triangles through Embree.

shape.py is what all of them offer, read.py the scene file's keys. May import numpy, cv2, embreex (triangles.py alone)
and counterlight.files.tables. Read next: shape.py.
"""

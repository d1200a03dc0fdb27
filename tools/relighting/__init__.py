"""Compute pictures from a light transport: composition, dual, and both of its inverse (thesis 3.4.1, 3.4.3, 5.1).

pictures.py reads and writes pictures, and relight.py computes the views.
May import player and tools.{transport,colour}. Read next: relight.py.
"""

"""Drawings over the picture: text and pages (osd.py), and the outline of a picture that is being placed (outline.py).

May import maps/ and pipeline/. Read next: osd.py.
"""

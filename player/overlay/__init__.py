"""What is drawn over the picture: letters and pages (osd.py), the outline of one that is being placed (outline.py).

May import maps/ and pipeline/. Read next: osd.py.
"""

"""The accuracy study: every method and knob on every scene and picture, measured, plotted and recommended.

pictures.py, rooms.py and methods.py define the pictures, the rooms and the methods. measure.py tries the methods.
jobs.py splits the work into jobs, for this machine or a cluster. results.py holds the figures. worth.py judges the
effects of a scene. questions/ answers questions about a user's own room. recommend.py and table_6_1.py evaluate the
figures, plots.py and sheets.py draw them, page.py lays out the report, and study.py runs all.

May import matplotlib (only plots.py and sheets.py), player and all other tools. Read next: methods.py, measure.py.
"""

"""What accuracy costs in time: every method and knob on every scene and picture, measured, plotted and recommended.

pictures.py is what is shown, rooms.py where, methods.py how; measure.py tries them, jobs.py says in which portions,
here or on a cluster, and results.py holds the figures. worth.py judges the effects of a scene, questions/ answers what
one asks about one's own room. recommend.py and table_6_1.py read the figures, plots.py and sheets.py draw them, page.py
lays out, study.py joins.
May import matplotlib (plots.py and sheets.py only), player and all other tools. Read next: methods.py, measure.py.
"""

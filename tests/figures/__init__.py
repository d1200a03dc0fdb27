"""make figures: the commands that pages of docs/ name for their figures, run again, and what differs from the pages.

rows.py says which page has which figures from which command, unchecked.py which tables none has and why, cells.py how
a table or a line of text is read and compared, __main__.py runs. Times are of the machine: they are compared by ratio,
listed apart, and decide nothing.
"""

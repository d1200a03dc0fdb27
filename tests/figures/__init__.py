"""make figures: the commands that pages of docs/ name for their figures, run again, and what differs from the pages.

tables.py and prose/ say which page has which figures from which command, rows.py has all of them, unchecked.py what
none has and why; printed.py is of commands that print figures in another form than the page. cells.py reads and
compares tables and lines of text, claims.py sentences, __main__.py runs. Times are of the machine: they are compared by
ratio, listed apart, and decide nothing.
"""

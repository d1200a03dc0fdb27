"""make figures: reruns the commands that pages of docs/ name for their figures, and lists differences from the pages.

tables.py and prose/ map figures of pages to commands; rows.py has all of them. unchecked.py lists figures without a
command, with the reason. printed.py serves commands that print figures in another form than the page. cells.py reads
and compares tables and lines of text, claims.py sentences. __main__.py runs the commands. Times depend on the machine:
they are compared by ratio, listed apart, and decide nothing.
"""

"""What one asks about one's own room, each question answered by trying: a module a question.

answers.py is what an answer is, place.py the room in which it is tried; acquiring.py, moving.py, coarser.py,
drifting.py and colours.py try, figures.py reads steps and maps off the figures of the study's methods; asked.py asks
them all, and page.py says them: a verdict, a plot, tables. May import what the study may. Read next: answers.py,
place.py, asked.py.
"""

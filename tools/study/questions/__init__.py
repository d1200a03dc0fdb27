"""Questions about a user's own room, each answered by trying; one module per question.

answers.py defines an answer, place.py the room in which questions are tried. acquiring.py, moving.py, coarser.py,
drifting.py and colours.py try. figures.py takes steps and maps from the figures of the study's methods. room_answers.py
asks all questions, and page.py presents them: a verdict, a plot, tables. May import what the study may. Read next:
answers.py, place.py, room_answers.py.
"""

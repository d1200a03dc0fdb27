"""A show in a window: what is played, when, and what those who watch it can do.

session.py joins the rest, from loop to loop: playlist.py says what comes, playback.py which frame is due, controls.py
what keys.py, settings.py and a control socket can do, osd.py and stats_page.py what is written over the picture.
options.py holds counterlight play's options. Knows no OpenGL: a display, a renderer and a clock are handed in.
Read next: session.py.
"""

"""Plays media in a window: what plays, when, and what viewers can control.

show.py is the main loop. session.py draws media; playlist.py and programme.py decide which medium plays, and
playback.py which frame is due. commands.py and properties.py implement what keys, settings and remotes can control,
through registry.py. overlay.py and stats_page.py write over the picture. options.py is the table of the options of
counterlight play, command_line.py reads them, from_options.py interprets them, and into_file.py renders into a file.
Knows no OpenGL: the display, the renderer and the clock are arguments. Read next: session.py.
"""

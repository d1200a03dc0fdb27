"""Plays media in a window: what plays, when, and what viewers can control.

show.py is the main loop. session.py takes each frame from the film to the screen; playlist.py and programme.py decide
which medium plays, and playback.py which frame is due. commands.py and properties.py implement what keys, settings and
remotes can control, through registry.py. overlay.py and stats_page.py write over the picture. options.py is the table
of the options of counterlight play, command_line.py reads them, and from_options.py interprets them. in_window.py plays
in a window, and into_file.py renders into a file. The session knows no OpenGL: the display, the renderer and the clock
are arguments. Read next: session.py.
"""

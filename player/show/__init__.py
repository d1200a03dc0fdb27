"""A show in a window: what is played, when, and what those who watch it can do.

show.py joins the rest, from loop to loop: session.py has media drawn, with playlist.py for what comes and playback.py
for which frame is due; commands.py and properties.py are what keys, settings and remotes can do with it, by the
registry; osd.py and stats_page.py are what is written over the picture. options.py holds counterlight play's options,
asked.py what they ask for, into_file.py what they write.
Knows no OpenGL: a display, a renderer and a clock are handed in. Read next: session.py.
"""

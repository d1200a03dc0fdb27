"""Remotes of a show: a page for browsers, and OSC, in a process of their own that the show has started.

The show hears it as one more client of the control socket (show/control.py), by a socket without a name; so whatever
comes from a network is parsed here, and what goes wrong here costs the remotes alone. show/remotes.py is the other end.
May import only counterlight.command, counterlight.errors and counterlight.unattended's JSON lines; websockets and
python-osc are the extras remote and osc.
Read next: __main__.py, link.py, web.py; docs/remote.md.
"""

"""Remotes of a show: a page for browsers, and OSC. They run in a separate process that the show starts.

The process is a client of the control socket (show/control.py), connected by an anonymous socket. Data from the network
is parsed only here, and an error here affects only the remotes. show/remotes.py is the other end.
May import only counterlight.command, counterlight.errors and counterlight.unattended's JSON lines. The extras `remote`
and `osc` install websockets and python-osc.
Read next: __main__.py, link.py, web.py; docs/remote.md.
"""

"""Shows that nobody watches: control from outside, signs of life, and the process that starts a dead player again.

May import only counterlight.command and counterlight.errors, since what watches must not fall with what it watches.
Read next: supervisor.py, and show/control.py, which the show itself serves; docs/unattended.md is the protocol.
"""

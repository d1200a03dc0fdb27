"""Shows that nobody watches: control from outside, signs of life, and the process that starts a dead player again.

May import only counterlight.command and player.errors: what watches must not fall with what it watches.
Read next: supervisor.py, control.py; docs/unattended.md is the protocol.
"""

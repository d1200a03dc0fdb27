"""Shows that nobody watches: control from outside, signs of life, and the process that starts a dead player again.

May import only counterlight.command and counterlight.errors, since what watches must not fall with what it watches;
control.py, which the show itself serves, knows show/registry.py.
Read next: supervisor.py, control.py; docs/unattended.md is the protocol.
"""

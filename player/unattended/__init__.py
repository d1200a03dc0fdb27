"""Unattended shows: remote control, heartbeats, and the process that restarts a dead player.

May import only counterlight.command and counterlight.errors, because a watcher must not fail with the watched player.
Read next: supervisor.py, and show/control.py, which the show itself serves; docs/unattended.md is the protocol.
"""

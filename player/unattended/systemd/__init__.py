"""The systemd unit that keeps a show running: counterlight.service. docs/unattended.md explains its installation.

No code lives here. Read next: player/unattended/supervisor.py, which the unit starts.
"""

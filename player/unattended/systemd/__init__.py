"""The systemd unit that keeps a show running: counterlight.service (docs/unattended.md tells how to install it).

No code lives here. Read next: player/unattended/supervisor.py, which the unit starts.
"""

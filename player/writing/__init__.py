"""Writes files completely or not at all, even if the process is killed or the disk is full.

disk.py holds the system calls: fsync, rename, atomic exchange, locks. stage.py manages the hidden folder in which
everything is created, and completes or removes such a folder that a killed process left. moves.py moves finished files
into place. Other code uses replacing.py for a file, a folder or a numbered sequence, and outputs.py to refuse bad
outputs before any work.

May import counterlight.errors only. Read next: replacing.py, stage.py.
"""

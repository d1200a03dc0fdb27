"""How anything gets onto the disk: whole or not at all, whatever kills the process and however full the disk is.

disk.py holds the system calls: fsync, rename, one-step exchange, locks. stage.py is the hidden folder in which
everything is made, and what is done with one whose maker died; moves.py takes what was made to its place; replacing.py
is what others use: a file, a folder, a numbered sequence. outputs.py says, before any work, what may not be written.
May import counterlight.errors only. Read next: replacing.py, stage.py.
"""

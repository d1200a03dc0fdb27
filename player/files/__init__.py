"""Files as they are read: opened once, bounded, checked; TOML, OpenEXR, PNG and JPEG, and which generation they are of.

May import errors, memory, writing/. Read next: reading.py, tables.py.
"""

"""Reads files safely: opened once, size-limited and checked. Handles TOML, OpenEXR, PNG, JPEG, and replaced folders.

May import errors, memory, writing/. Read next: reading.py, tables.py.
"""

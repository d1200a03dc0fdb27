"""The packed matrix format, and the folder correction/ of a calibration that holds a room's maps in this format.

May import arrays, calibration, errors, files/, memory, writing/. Read next: row_map.py (the contract), chain.py
(products of matrices), room_maps.py.
"""

"""Everything that runs once per frame: the player and the files it reads.

Whatever is read from outside comes in through reading.py (files, TOML), tables.py, picture_files.py and exr.py.
Holds the calibration folder, the row map (the one packed matrix format), its CPU twin, pictures and their colours.
decoding/ is how media come in, gl/ how they are drawn, show/ the loop in a window, unattended/ what watches over it.
May import numpy, OpenEXR, cv2 and PyAV; never `tools`, never scipy. Only `counterlight.gl` touches moderngl and glfw.
Read next: row_map.py (the contract), reference.py (the mathematics), app.py (the command).
"""

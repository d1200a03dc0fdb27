"""Make a calibration folder: acquire it with a projector and a camera, or import measurements.

Acquiring: acquire.py runs a scheme of schemes/ with a camera of cameras/. store.py keeps every capture on disk, and
acquired_room.py writes the folder. plan.py holds the types that they share.
Importing: captures.py finds which file shows which Gray-code pattern, graycode.py decodes the files, and
direct_mapping.py makes T from the decoded pixels. graycode_room.py and matrices_room.py write the folder.
May import numpy, scipy, cv2, player and the rest of tools. Read next: plan.py, acquire.py; graycode.py.
"""

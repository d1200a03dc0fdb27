"""From a projector and a camera, or from what others measured, to a calibration folder.

Acquiring: acquire.py runs a scheme of schemes/ with a camera of cameras/; store.py keeps every capture on disk;
acquired_room.py writes the folder. plan.py holds what they share.
Importing: captures.py finds which file is which Gray-code pattern, graycode.py decodes them, direct_mapping.py makes T
of the decoded pixels; graycode_room.py and matrices_room.py write the folder.
May import numpy, scipy, cv2, player and the rest of tools. Read next: plan.py, acquire.py; graycode.py.
"""

"""From what others measured to a calibration folder: matrices of their own, or photographs of Gray-code patterns.

picture_files.py reads whole pictures, captures.py finds which file is which pattern, graycode.py decodes them,
direct_mapping.py makes T of the decoded pixels; graycode_room.py and matrices_room.py write the folder.
May import numpy, scipy, cv2, player and tools.transport. Read next: graycode.py, direct_mapping.py.
"""

"""Merge exposure brackets to radiance maps, and fit a projector's response to grey ramps (thesis 3.3).

bracket.py and raw_files.py read pictures and their exposure times. recovery.py recovers the camera's response, and
camera_response.py makes a table of it. estimators.py holds equations 3.4 to 3.7, and radiance.py merges.
projector_response.py fits the projector's response to grey levels that grey_ramp.py reads.
May import numpy, scipy, PIL, player and counterlight.files.picture_files. Read next: estimators.py, radiance.py.
"""

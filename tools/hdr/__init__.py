"""From exposure brackets to radiance maps, and from grey ramps to a projector's response (thesis 3.3).

bracket.py and exif.py read pictures and their times; debevec.py and robertson.py recover the camera's response,
camera_response.py makes a table of it; weights.py and estimators.py hold equations 3.4 to 3.7, radiance.py merges.
projector_response.py fits the projector's response to measured grey levels, grey_ramp.py reads those.
May import numpy, scipy, PIL, player and counterlight.files.picture_files. Read next: estimators.py, radiance.py.
"""

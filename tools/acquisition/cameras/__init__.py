"""Cameras behind one small protocol (camera.py), with the conversion of stored code values to radiance.

live.py combines a screen and a camera that this program controls. simulated.py, video.py (v4l2), machine_vision.py
(pylon) and tethered.py (gphoto2) take the frames; together.py joins several cameras. window.py is a screen, also of
several projectors. folder.py exchanges files with any other program that photographs.
May import numpy, cv2, PIL, player and the rest of tools. Read next: camera.py, live.py.
"""

"""What captures, behind one small protocol (camera.py, with how stored code values become radiance).

live.py: a screen and an eye, both in our hands; simulated.py, video.py (v4l2), machine_vision.py (pylon) and
tethered.py (gphoto2) are eyes, window.py is a screen, side_by_side.py one of several. folder.py: any other program
photographs.
May import numpy, cv2, PIL, player and the rest of tools. Read next: camera.py, live.py.
"""

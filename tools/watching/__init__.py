"""Calibrate a room from the running film (docs/watch.md): the process behind `counterlight play --watch`.

view.py reduces T and the captures to blocks of the camera picture. timeline.py finds out which frames a capture saw.
evidence.py compares a capture with its prediction. estimate.py finds the changes of the room from many comparisons, and
learning.py finds changes of the wall that stay. watcher.py decides what is applied. cameras.py opens the cameras, and
process.py exchanges the messages.
May import numpy, scipy, cv2, player and the rest of tools. Read next: watcher.py, evidence.py.
"""

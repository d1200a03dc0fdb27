"""OpenGL: the only importer of moderngl and glfw.

Holds the passes (one object each, built once, released by its maker), the device that makes them, and the window.
OpenGL's flipped rows exist only here. Every shader in `shaders/` has a CPU twin in player/pipeline/reference.py.
Read next: device.py.
"""

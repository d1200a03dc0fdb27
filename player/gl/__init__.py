"""OpenGL: the only importer of moderngl and glfw.

Holds the passes (one object each, built once, released by its maker), the pipeline that chains them, and the window.
OpenGL's flipped rows exist only here. Every shader in `shaders/` has a CPU twin in player/reference.py.
Read next: renderer.py.
"""

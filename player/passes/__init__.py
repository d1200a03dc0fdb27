"""The passes of a frame: one module per pass, with its inputs, the name of its GLSL file, and its CPU function.

drawing.py says what a pass is. gl/ draws passes with their shaders, and pipeline/cpu_renderer.py with their CPU
functions. kernel.py compiles CPU functions with Numba, on first use; rare passes compute with numpy. May import files/,
maps/, media/ and response. Read next: drawing.py, combine.py, desired.py.
"""

"""The order of a frame's passes, written once for every device: decode, place, adapt, correct, refine, encode.

device.py is the interface of a backend. gl/ implements it with OpenGL, and cpu_renderer.py with the CPU functions of
counterlight.passes. room_view.py holds what belongs to one view of the room. view_blend.py makes drives for one view or
several. May import calibration, errors, response, viewpoints, files/, maps/, media/ and passes/. Read renderer.py next.
"""

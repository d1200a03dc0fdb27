"""The order of a frame's passes, written once for every device: decode, place, adapt, correct, refine, encode.

frame_passes.py lists the passes in order. device.py is the interface of a backend. gl/ implements it with OpenGL, and
cpu_renderer.py with the CPU functions of counterlight.passes. room_view.py holds what belongs to one view of the room.
view_blend.py makes drives for one view or several. May import calibration, errors, response, viewpoints, files/, maps/,
media/ and passes/. Read next: frame_passes.py, renderer.py.
"""

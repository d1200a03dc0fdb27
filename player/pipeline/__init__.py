"""The steps of a frame, written once for every device: decode to linear light, place, adapt, correct, refine, encode.

device.py is the interface of a backend. reference.py holds the CPU function of every shader; adaptation.py and drift.py
hold those for adaptation and drift. reference_renderer.py runs these functions, and tests compare both backends with
it: gl/, and cpu_renderer.py over compiled.py. Only compiled.py imports Numba. room_view.py holds what belongs to one
view of the room. view_blend.py makes drives for one view or several. May import calibration, errors, response,
viewpoints, files/, maps/ and media/. Read next: renderer.py, reference.py.
"""

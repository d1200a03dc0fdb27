"""What a frame goes through, said once for every device: decode to linear light, place, adapt, correct, refine, encode.

device.py is what a backend offers, reference.py holds the shaders' twins (adaptation.py those of what adapts a picture,
drift.py that of a moved one), reference_renderer.py runs them, and both backends are held to it: gl/, and
cpu_renderer.py over compiled.py, which alone imports Numba. eye.py is what belongs to one camera's room, company.py
makes drives for one eye or for several, which viewers between views have. May import calibration, errors, response,
viewpoints, files/, maps/ and media/. Read next: renderer.py, reference.py.
"""

"""What a frame goes through, said once for every device: decode to linear light, place, adapt, correct, refine, encode.

device.py is what a backend offers, reference.py holds the shaders' twins (adaptation.py those of what adapts a picture,
drift.py that of a moved one), reference_renderer.py runs them, and both backends are held to it: gl/, and
cpu_renderer.py over compiled.py, which alone imports Numba. May import calibration, errors, response, files/, maps/ and
media/. Read next: renderer.py, reference.py.
"""

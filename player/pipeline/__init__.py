"""What a frame goes through, said once for every device: decode to linear light, place, adapt, correct, refine, encode.

device.py is what a backend offers, reference.py holds the shaders' twins (adaptation.py those of what adapts a picture,
drift.py that of a moved one), cpu_renderer.py runs them; gl/ is the other backend. May import calibration,
errors, response, files/, maps/ and media/. Read next: renderer.py, reference.py.
"""

"""Simulated rooms: a scene file (TOML) becomes a light transport T = C (I − K)⁻¹ P, in parts, and ambient light e.

scene.py is the file format, geometry.py the rays, materials.py the surfaces' albedo, needs.py decides which effects a
scene calls for, effects/ holds one module each, imported only when needed; simulate.py puts them together.
May import numpy, scipy, cv2, player and tools.transport. Read next: scene.py, simulate.py.
"""

"""The inverse light transport T⁺ (thesis 5.1), regularised, truncated within a stated bound, ready to pack.

clustered.py inverts small clusters whole, windowed.py large ones through overlapping windows, damping.py chooses λ,
truncation.py drops what does not matter, far_light.py takes the smooth indirect light out beforehand.
May import scipy, player.command and tools.{transport,clusters}. Read next: inverse.py, which puts them together.
"""

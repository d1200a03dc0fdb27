"""The inverse light transport T⁺ (thesis 5.1), regularised, truncated within a stated bound, ready to pack.

clustered.py inverts small clusters whole, windowed.py large ones through windows, method.py says which; damping.py
chooses λ by bidiagonal.py, noise.py is what T does not know, pieces.py and truncation.py drop what does not matter,
far_light.py takes the smooth indirect light out beforehand, memory.py refuses what cannot fit;
refinement_maps.py packs what refinement needs, room.py all that the player needs.
May import scipy, counterlight.command and tools.{transport,clusters}. Read next: inverse.py, which puts them together.
"""

"""The inverse light transport T⁺ (thesis 5.1), regularised, truncated within a stated bound, ready to pack.

clustered.py inverts small clusters whole, windows.py large ones through windows by banded.py, super_blocks.py those on
other machines, method.py says which; price.py whether that pays, direct.py is what stays if nothing does; damping.py
chooses λ by bidiagonal.py, of large pictures on squares.py; noise.py is what T does not know, rows.py and truncation.py
drop what does not matter, near_light.py puts them together; far_light.py takes the smooth indirect light out
beforehand, memory.py refuses what cannot fit; refinement_maps.py packs what refinement needs, recommendation.py finds
how many steps. May import scipy, counterlight.{command,jobs} and tools.{transport,clusters}. Read next: build.py, which
makes all that the player needs.
"""

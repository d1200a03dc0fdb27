"""The inverse light transport T⁺ (thesis 5.1), regularised, truncated within a stated bound, ready to pack.

near_light.py combines all steps. method.py chooses how clusters are inverted. clustered.py inverts small clusters
whole; windows.py inverts large clusters through windows, with banded.py; super_blocks.py does so on other machines.
price.py decides whether an inverse pays; direct.py replaces it otherwise. damping.py chooses λ with bidiagonal.py, for
large pictures on squares (pictures.py). noise.py estimates the noise of T; rows.py drops negligible entries.
far_light.py removes the smooth indirect light beforehand; memory.py refuses work that cannot fit. refinement_maps.py
packs the inputs of refinement; recommendation.py finds the number of steps. May import scipy,
counterlight.{command,jobs} and tools.{transport,clusters}. Read next: build.py, which makes everything that the player
needs.
"""

"""Replace long rows of a blurred T by few cells of a pyramid: T ≈ S + B P (docs/mathematics.md 4).

pruning.py makes cells of a row's entries, up to a limit. blurring.py decides when to do so, finds the limit for a
tolerance in decibels, and processes a complete T; the simulator processes T band by band.
May import numpy, Numba, player and counterlight.tools.{transport,inverse}. Read next: pruning.py.
"""

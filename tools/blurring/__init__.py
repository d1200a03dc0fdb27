"""T's rows of wide blur as few cells of a pyramid: T ≈ S + B P (docs/mathematics.md 4).

pruning.py makes cells of a row's entries, to a limit; choice.py finds the limit that a tolerance in decibels allows;
blurring.py says when, and does it to a T that is there as a whole; the simulator does it band by band.
May import numpy, Numba, player and counterlight.tools.{transport,inverse}. Read next: pruning.py.
"""

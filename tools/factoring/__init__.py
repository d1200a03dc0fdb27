"""A dense light transport as near light plus factors, T = S + U M D, to a stated loss (docs/mathematics.md 3).

grid.py is the nodes that far light is interpolated between, model.py fits it, near.py says what stays as entries,
losses.py what pictures lose, factoring.py decides and reports; passes.py holds the loops over T's rows, compiled.
May import numpy, scipy, numba, player and tools.{blurring,transport,inverse.pictures}. Read next: factoring.py.
"""

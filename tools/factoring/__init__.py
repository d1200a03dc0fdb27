"""Factor a dense light transport into near light and factors, T = S + U M D, to a stated loss (docs/mathematics.md 3).

grid.py holds the nodes between which far light is interpolated. model.py fits far light, near.py selects the near
entries, and losses.py measures the loss of pictures. factoring.py decides and reports; passes.py holds the compiled
loops over T's rows.
May import numpy, scipy, numba, player and tools.{blurring,transport,inverse.pictures}. Read next: factoring.py.
"""

"""Factor a dense light transport into near light and factors, T = S + U M D, to a stated loss (docs/mathematics.md 3).

model.py fits far light, which is interpolated between the nodes of grids, and selects the near entries. losses.py
measures the loss of pictures. factoring.py decides and reports; passes.py holds the compiled loops over T's rows.
May import numpy, scipy, numba, player and tools.{blurring,transport,inverse.pictures}. Read next: factoring.py.
"""

"""Formulas for reliefs, one per module: heights(u, v) -> 0..1, 0 for no relief. May import numpy."""

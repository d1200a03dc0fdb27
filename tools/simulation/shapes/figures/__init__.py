"""Figures by formula for reliefs, one a module: heights(u, v) -> 0..1, 0 where there is nothing. May import numpy."""

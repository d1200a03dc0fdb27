"""Figures in prose, by what they are of."""

from tests.figures.prose import measuring, quality, scenes

PROSE = (*quality.PROSE, *measuring.PROSE, *scenes.PROSE)

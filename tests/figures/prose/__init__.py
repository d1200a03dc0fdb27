"""Figures in prose, by what they are of."""

from tests.figures.prose import quality

PROSE = (*quality.PROSE,)

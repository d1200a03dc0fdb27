"""Figures in prose, by subject."""

from tests.figures.prose import measuring, methods, refining, rig, scenes

PROSE = (*rig.PROSE, *methods.PROSE, *refining.PROSE, *measuring.PROSE, *scenes.PROSE)

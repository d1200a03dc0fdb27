"""Formulas in numpy that tests compare the passes with. Read first: formulas.py, renderer.py."""

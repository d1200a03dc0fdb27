"""Optical effects, one module each, built (and imported) only when the scene calls for them; see needs.py."""

"""Optical effects, one module per effect, imported only when the scene calls for them; see needs.py."""

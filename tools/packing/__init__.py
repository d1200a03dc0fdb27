"""From scipy matrices to row maps. May import player and counterlight.tools.transport; see row_maps.py."""

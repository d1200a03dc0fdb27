"""From scipy's matrices to the player's row maps. May import player and counterlight.tools.transport; see row_maps.py."""

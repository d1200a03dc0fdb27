"""From a transport to row maps. May import player and counterlight.tools.transport; see refinement_maps.py."""

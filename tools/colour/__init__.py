"""The projector's primaries as the camera's channels see them (thesis 4.1.1), and the resulting form of a room.

neutral.py finds the mixing of a neutral surface. tiers.py converts a calibration and its transport to coordinates in
which channels nearly decouple; solvers and maps need nothing else. shared.py finds primaries that different projectors
have in common. counterlight.maps.mixing defines the mixing. May import player and tools.transport. Read next: tiers.py.
"""

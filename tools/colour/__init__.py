"""Which of the projector's primaries a camera's channels see (thesis 4.1.1), and what that makes of a room.

neutral.py finds the mixing of a neutral surface, tiers.py turns a calibration and its transport into those in which
channels nearly decouple: all that solvers and maps need to know; shared.py finds primaries that unlike projectors have
in common. The mixing itself is counterlight.maps.mixing. May import player and tools.transport. Read next: tiers.py.
"""

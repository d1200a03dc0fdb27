"""Rooms for other programs, which warp a picture and scale its pixels. Only the diagonal of T remains.

diagonal.py reduces T to a place, a factor and an offset per projector pixel, and measures what is lost. files.py writes
MPCDI, ST maps, .cube tables and OpenColorIO configurations. May import player, api.py, inverse and transport.
Read next: diagonal.py.
"""

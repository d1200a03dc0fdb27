"""Joins calibrations of one room: several projectors, several cameras, or several views for viewers that move.

projectors.py puts projectors next to each other, cameras.py puts cameras below each other, and views.py makes a set of
views. Each T is factored first. shared_screen.py places cameras on one screen by the light that they share;
smooth_field.py continues places where nothing is shared. May import player and tools.{colour,factoring,hdr,transport}.
Read next: projectors.py.
"""

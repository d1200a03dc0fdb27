"""The light transport of a room: c = T p + e, T = S + U M D (near light as sparse rows, far light as factors).

transport.py is the mathematics (apply, transpose, floodlight), storage.py the files. May import scipy and player.
Read next: transport.py.
"""

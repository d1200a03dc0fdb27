"""The light transport of a room: c = T p + e, T = S + U M D (near light as sparse rows, far light as factors).

transport.py is the mathematics (apply, transpose, floodlight, mask), and mask.py finds the camera pixels that count.
storage.py reads and writes the files: sparse_files.py knows scipy's layouts, arrays.py the archives. joining.py puts
projectors side by side, joining_cameras.py puts cameras below each other, and joining_views.py makes a set of views;
each T is factored first. ties.py and smooth_field.py find where cameras look, shared_screen.py puts cameras on one
screen, shares.py weighs them; gloss.py finds highlights. May import scipy and player; joining.py and joining_cameras.py
also import tools.factoring. Read next: transport.py.
"""

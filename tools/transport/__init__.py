"""The light transport of a room: c = T p + e, T = S + U M D (near light as sparse rows, far light as factors).

transport.py is the mathematics (apply, transpose, floodlight, inside a mask), mask.py says which camera pixels count,
storage.py is the files: sparse_files.py the layouts of scipy's matrices, arrays.py the archives that they are in;
joining.py puts projectors side by side, joining_cameras.py cameras below each other, joining_views.py makes a set of
views from several places, each T factored first. ties.py and smooth_field.py find where cameras look, shared_screen.py
puts them on one screen, shares.py says what each counts; gloss.py finds highlights.
May import scipy and player, joining.py and joining_cameras.py also tools.factoring. Read next: transport.py.
"""

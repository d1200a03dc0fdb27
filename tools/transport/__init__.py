"""The light transport of a room: c = T p + e. T is near light S plus a sum of chains, B P and U M D.

transport.py is the mathematics (apply, transpose, floodlight, mask), and mask.py finds the camera pixels that count.
storage.py reads and writes the files: sparse_files.py knows scipy's layouts, arrays.py the archives. objective.py
states what a drive shall minimise: trust.py weighs camera pixels, overlap.py finds ties between
neighbours, and gloss.py finds highlights. mixing.py mixes channels. interval.py says how far captures may be from
their predictions. May import scipy, cv2 and player. Read next: transport.py.
"""

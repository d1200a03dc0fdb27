"""Pictures that a light transport makes: composition, dual, and both of its inverse (thesis 3.4.1, 3.4.3, 5.1).

pictures.py reads what is projected and writes what is seen, relight.py makes one of the other.
May import player and tools.{transport,colour}. Read next: relight.py.
"""

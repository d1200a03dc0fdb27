"""Pictures that a light transport makes: composition, dual, and both of its inverse (thesis 3.4.1, 3.4.3, 5.1).

views.py is the mathematics, pictures.py reads what is projected and writes what is seen, relight.py joins them.
May import scipy, player and counterlight.tools.transport. Read next: views.py.
"""

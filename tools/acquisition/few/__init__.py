"""Pictures first: a room from as few pictures as there are, nine or more, the most important ones before the others.

order.py says which, turns.py which projector's; acquire.py shows them until somebody says stop, and makes a room of
those that there are, views.py camera by camera.
seen.py, reference.py: captures as equations, with black, primaries and noise. places.py, settling.py: where camera
pixels look. near.py, far.py: what they see there, and from everywhere. fitting.py: T of all that; held_out.py: how good
it is. response.py: the projector's curves. May import numpy, scipy, player and the rest of tools but commands. Read
next: order.py, fitting.py.
"""

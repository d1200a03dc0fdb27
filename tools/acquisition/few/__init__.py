"""Acquisition from few pictures, nine or more, the most important first.

order.py defines the pictures, and the turns of several projectors. acquire.py shows the pictures until it is stopped
and makes a room of the captures; views.py fits each camera.
seen.py: captures as equations, with black, primaries and noise. places.py: the place that each camera
pixel sees. near.py, far.py: near and far light. fitting.py: T. held_out.py: its accuracy. response.py: the projector's
response. May import numpy, scipy, player and the rest of tools except commands. Read next: order.py, fitting.py.
"""

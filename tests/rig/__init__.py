"""An independent simulation: projector, room and camera that share nothing with the product's model of them.

Light (spectra), rays and footprints make a room. Projector and camera make a rig. The product uses the rig only
through its documented commands (product.py) and files. Nothing here imports player or tools. Read rooms.py, view.py,
rig.py, then judge.py and table.py. `python -m tests.rig` prints the table.
"""

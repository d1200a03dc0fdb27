"""An eye from outside: projector, room and camera that share nothing with the product's model of them.

Light (spectra), rays and footprints make a room; projector and camera make a rig; the product meets it only through its
documented commands (product.py) and files. Nothing here imports player or tools. Read rooms.py, view.py, rig.py, then
judge.py and table.py; `python -m tests.rig` prints the table.
"""

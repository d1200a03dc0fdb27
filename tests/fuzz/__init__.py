"""Campaigns against the product: random damage, hostile names, kills, full disks, floods.

The same seed gives the same damage.

`python -m tests.fuzz [CAMPAIGN …] --seed N` (or `make fuzz`) runs them and prints a line for each. A campaign of files
draws files from random numbers and judges them in a process that may die (warden.py). The other campaigns run whole
commands and shows. Damage comes from tests/mutants.py and tests/samples.py, faults from tests/faults.py. Read
tally.py first, then the campaigns. docs/reliability.md reports long runs.
"""

"""How many captured pixels lie inside the interval that an acquisition has stored, per room and fault."""

import sys
from pathlib import Path

import numpy as np

from tests.rig import product
from tests.rig.faults import Fault
from tests.rig.pictures import PICTURES
from tests.rig.rig import Rig
from tests.rig.rooms import Room
from tests.rig.trial import given

COLUMNS = {
    "inside, %": "inside",
    "dark, %": "dark",
    "middle, %": "middle",
    "bright, %": "bright",
    "mean width, % of white": "width",
    "one width, % of white": "constant",
    "expected, dB": "expected",
}


def coverage(room: Room, fault: Fault, folder: Path) -> dict[str, str]:
    """Acquire a room, show every picture once, and photograph it; returns a row of the table, with means."""
    folder.mkdir(parents=True)
    rig = Rig(room, fault.devices)
    expected = product.expected_decibels(product.acquire(rig, folder, *given(fault, folder)))
    found = []
    for seed, make in enumerate(PICTURES.values(), 1):
        picture = make(rig.camera)
        picture.write(path := folder / f"{picture.name}.png")
        found.append(product.covered(rig, folder, path, seed=seed) | {"expected": expected})
    print(f"{room.name}: {fault.name}", file=sys.stderr, flush=True)
    means = {name: float(np.mean([each[name] for each in found])) for name in found[0]}
    return {"room": room.name, "fault": fault.name} | {
        heading: f"{means[name]:.2f}" if "width" in heading else f"{means[name]:.1f}"
        for heading, name in COLUMNS.items()
    }

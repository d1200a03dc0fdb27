"""Roughness of T for right and for swapped sizes: python -m tests.studies.pixel_order prints both tables.

The thresholds of counterlight/tools/transport/pixel_order.py come from these tables. `ratio` is the roughness for the
given sizes over the roughness for the smoothest other reading, if that reading is smooth (at most SMOOTH).
"""

import argparse
from collections import defaultdict
from itertools import product

import numpy as np

from counterlight.maps.row_map import SparseRows
from counterlight.tools.shipped import shipped_scenes
from counterlight.tools.simulation.scene import load_scene
from counterlight.tools.simulation.simulate import simulate
from counterlight.tools.transport.pixel_order import LEAST_SIDE, SMOOTH, Reading, Shape, roughnesses
from counterlight.tools.transport.transport import Csr, in_one, stacked
from tests.pixel_orders import right_ones, smooth

SIZES: list[Reading] = [
    ((24, 32), (18, 24)),
    ((12, 16), (9, 14)),
    ((54, 96), (48, 80)),
    ((40, 64), (48, 64)),
    ((9, 12), (30, 40)),
]


def ratio(near: SparseRows, camera: Shape, projector: Shape) -> float:
    """Returns the ratio of roughnesses; NaN if no other reading is smooth."""
    if min(*camera, *projector) < LEAST_SIDE:
        return float("nan")
    given, *others = roughnesses(near, camera, projector).values()
    best = min(others, default=np.inf)
    return given / best if best <= SMOOTH and given < np.inf else float("nan")


def swapped(camera: Shape, projector: Shape) -> dict[str, Reading]:
    """Returns the wrong readings of a room by the swapped sizes, without those that equal the right reading."""
    return {
        name: reading
        for name, reading in (
            ("camera", (camera[::-1], projector)),
            ("projector", (camera, projector[::-1])),
            ("both", (camera[::-1], projector[::-1])),
        )
        if reading != (camera, projector)
    }


def rows(T: Csr) -> SparseRows:
    return stacked([T.astype(np.float32)] * 3)


def sides(rng: np.random.Generator) -> Shape:
    height, width = rng.integers(LEAST_SIDE, 50, 2)
    return int(height), int(width)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rooms", type=int, default=100, help="number of random rooms of each kind")
    rooms, rng = parser.parse_args().rooms, np.random.default_rng(7)
    found = defaultdict(list)
    for _ in range(rooms):
        camera, projector = sides(rng), sides(rng)
        for kind, (T, *given) in right_ones(rng, camera, projector).items():
            found[kind].append(ratio(rows(T), *given))
        for what, given in swapped(camera, projector).items():
            found[f"swapped: {what}"].append(ratio(rows(smooth(rng, camera, projector)), *given))
    print("| random rooms | largest ratio | least ratio | rooms with a smooth other reading |\n|---|---|---|---|")
    for kind, ratios in found.items():
        finite = [each for each in ratios if not np.isnan(each)]
        span = f"{max(finite):.1f} | {min(finite):.1f}" if finite else "- | -"
        print(f"| {kind} | {span} | {len(finite)} of {len(ratios)} |")
    print(
        "\n| shipped scene | camera, projector | right | camera swapped | projector swapped | both |\n"
        "|---|---|---|---|---|---|"
    )
    for (name, path), sizes in product(shipped_scenes().items(), SIZES):
        scene = load_scene(path).resized(*sizes)
        near = in_one(simulate(scene.views[0]).transport)
        wrong = " | ".join(f"{ratio(near, *each):.1f}" for each in swapped(*sizes).values())
        print(f"| {name} | {sizes} | {ratio(near, *sizes):.1f} | {wrong} |", flush=True)


if __name__ == "__main__":
    main()

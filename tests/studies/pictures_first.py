"""Quality over the number of pictures: python -m tests.studies.pictures_first.

In the rooms of the rig (tests/rig, docs/rig.md) the product acquires with `--pictures N`, and with the schemes that
take as many pictures as they need. The product builds and shows with its defaults, and is judged like in
python -m tests.rig: dB inside the border, mean of three pictures. Prints the table of docs/schemes.md.
All of it is simulated.
"""

import argparse
import itertools
import os
import re
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from tests.rig import product
from tests.rig.faults import FAULTS
from tests.rig.judge import Judge
from tests.rig.pictures import PICTURES
from tests.rig.rig import Rig
from tests.rig.rooms import ROOMS
from tests.rig.trial import given

COUNTS = 9, 16, 48, 128
SCHEMES = "hierarchical", "multiplexed"
ALL = re.compile(r"^(\d+) pictures, ", re.MULTILINE)


def captured(rig: Rig, folder: Path, *options: str) -> tuple[int, float]:
    """Returns the number of pictures of an acquisition, and the resulting quality in dB."""
    said = product.acquire(rig, folder, *options)
    found = ALL.search(said)
    assert found, said
    product.build(folder)
    judge, figures = Judge(rig), []
    for picture in (make(rig.camera) for make in PICTURES.values()):
        path = folder / f"{picture.name}.png"
        picture.write(path)
        shown = product.show(folder, path)
        question = judge.asks(picture, shown.white, product.show_plain(folder, path).codes)
        figures.append(judge.figures(question, shown.codes).inside)
    return int(found[1]), float(np.mean(figures))


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.studies.pictures_first", description=__doc__)
    parser.add_argument(
        "counts",
        nargs="*",
        type=int,
        default=list(COUNTS),
        metavar="N",
        help="numbers of pictures (default 9 16 48 128)",
    )
    parser.add_argument("--room", nargs="+", choices=ROOMS, default=list(ROOMS), help="rooms to try (default all)")
    parser.add_argument(
        "--fault", nargs="+", choices=FAULTS, default=["known", "home"], help="kinds of devices (default known home)"
    )
    parser.add_argument(
        "--scheme", nargs="*", default=list(SCHEMES), help=f"schemes to compare (default {' '.join(SCHEMES)})"
    )
    parser.add_argument(
        "--scale", type=float, default=1.0, help="scale: 1 has a camera of 160x120, a projector of 96x72"
    )
    options = parser.parse_args()
    ways = {f"{count} pictures": ("--pictures", str(count)) for count in options.counts}
    ways |= {scheme: ("--scheme", scheme) for scheme in options.scheme}
    places = [(room, fault) for fault in options.fault for room in options.room]
    with (
        threadpool_limits(limits=1),
        tempfile.TemporaryDirectory(prefix="pictures-first-") as folder,
        ThreadPoolExecutor(os.cpu_count()) as pool,
    ):

        def judged(job: tuple[str, tuple[str, str]]) -> str:
            way, (room, fault) = job
            here = Path(folder, "-".join((room, fault, *way.split())))
            here.mkdir()
            rig = Rig(ROOMS[room](options.scale), FAULTS[fault].devices)
            pictures, decibels = captured(rig, here, *ways[way], *given(FAULTS[fault], here))
            print(f"{room}, {fault}, {way}: {decibels:.1f} dB of {pictures} pictures", flush=True)
            return f"{decibels:.1f}"

        jobs = list(itertools.product(ways, places))
        cells = dict(zip(jobs, pool.map(judged, jobs), strict=True))
    print(f"\n| room | fault | {' | '.join(ways)} |\n|---|---{'|---' * len(ways)}|")
    for place in places:
        print(f"| {' | '.join([*place, *(cells[way, place] for way in ways)])} |")


if __name__ == "__main__":
    main()

"""Direct mapping, the product and the unweighted optimum in shipped, rig and random rooms: docs/tables/optimum.md.

    python -m tests.studies.optimum [--random N]

T is exact. Figures are decibels against white over lit pixels, and in parentheses inside the border, means of five
pictures. scipy finds the optimum (tests/unweighted.py). The product uses its defaults: a still picture in a file, and
the first frame in a window.
"""

import argparse
from collections.abc import Iterator

import numpy as np
from scipy import sparse

import counterlight as cl
from counterlight.pipeline.refinement import STEPS_OF_A_STILL
from counterlight.tools.shipped import shipped_scenes
from counterlight.tools.study.pictures import find_pictures
from tests.grey_rooms import GreyRoom, shipped_in_green
from tests.random_rooms import random_room
from tests.rig.rig import Devices, Rig
from tests.rig.rooms import ROOMS
from tests.unweighted import Judge

CAMERA, PROJECTOR = (48, 64), (36, 48)
RIG_SCALE = 0.5
RANDOM = 10
WAYS = ("direct mapping", "optimum", "file", "window")
LOSSES = ("most below the optimum inside, dB", "least above direct mapping, dB")


def shipped() -> Iterator[GreyRoom]:
    for name, scene in shipped_scenes().items():
        if "[[views]]" not in scene.read_text():
            yield shipped_in_green(name, CAMERA, PROJECTOR)


def of_the_rig() -> Iterator[GreyRoom]:
    """Yield the rig's rooms with one primary, as one channel sees it."""
    for name, make in ROOMS.items():
        rig = Rig(make(RIG_SCALE), Devices())
        pixels, lamps = (size[0] * size[1] for size in (rig.camera, rig.raster))
        part = slice(pixels, 2 * pixels), slice(lamps, 2 * lamps)
        T = rig.transport.near[part].toarray().astype(np.float64)
        if rig.transport.far is not None:
            U, G, D = rig.transport.far
            patches = G.shape[1] // 3
            columns = slice(patches, 2 * patches)
            T += U[part[0]] @ (G[:, columns] @ D[columns, part[1]].toarray())
        yield GreyRoom(f"rig: {name}", sparse.csr_array(T), rig.camera, rig.raster, float(np.median(rig.ambient)))


def random(count: int) -> Iterator[GreyRoom]:
    for seed in range(count):
        given = random_room(seed)
        yield given._replace(name=f"random {seed}: {given.name}, {_size(given.camera)} and {_size(given.projector)}")


def pictures(camera: tuple[int, int]) -> dict[str, np.ndarray]:
    """Returns grey pictures, in shares of white."""
    x = (np.arange(camera[1]) + 0.5) / camera[1]
    found = {picture.name: picture.at(camera)[..., 1] for picture in find_pictures(("photograph", "film"))}
    return {"white": np.ones(camera), "half": np.full(camera, 0.5), "ramp": np.tile(x, (camera[0], 1)), **found}


def line(given: GreyRoom) -> str:
    """Returns a room's row: means over the pictures; for files, how far the worst picture is below the optimum."""
    room, judge = given.in_product, Judge(given.T, given.camera)
    maps = cl.build_maps(room)
    found = {way: list[tuple[float, float]]() for way in WAYS}
    for picture in pictures(given.camera).values():
        b = (maps.white * picture - given.ambient).ravel()
        drives = {"optimum": judge.optimum(b), "direct mapping": judge.direct(b)}
        for way, steps in (("file", STEPS_OF_A_STILL), ("window", None)):
            with cl.Renderer(room, maps, backend="cpu") as renderer:
                shown = renderer.render(np.repeat(picture[..., None], 3, axis=2), refine=steps)
            drives[way] = shown[..., 1].ravel()
        for way, drive in drives.items():
            found[way].append(judge.psnr(drive, b, maps.white))
    means = ["{:.1f} ({:.1f})".format(*np.mean(found[way], axis=0)) for way in WAYS]
    direct, best, file, _ = (np.array(found[way]) for way in WAYS)
    losses = f"{np.max(best[:, 1] - file[:, 1]):.1f} | {np.min(file[:, 0] - direct[:, 0]):.1f}"
    return f"| {given.name} | {' | '.join(means)} | {losses} |"


def _size(shape: tuple[int, int]) -> str:
    return f"{shape[1]}x{shape[0]}"


def main() -> None:
    parser = argparse.ArgumentParser("python -m tests.studies.optimum", description=__doc__)
    parser.add_argument(
        "--random", type=int, default=RANDOM, metavar="N", help=f"number of random rooms (default {RANDOM})"
    )
    count = parser.parse_args().random
    columns = ("room", *WAYS, *LOSSES)
    print(f"| {' | '.join(columns)} |\n{'|---' * len(columns)}|")
    for group in (shipped(), of_the_rig(), random(count)):
        for given in group:
            print(line(given), flush=True)


if __name__ == "__main__":
    main()

"""The experiment of thesis 6.1: python -m tests.studies.brickstone prints docs/tables/brickstone.md.

A flat wall is compared with the brickstone wall of brickstone.toml: with its relief alone, and also with the light that
enters the stone. Light from brick to brick is left out. With it, T would be dense and the thesis' cut would not fit any
memory. The methods are direct mapping to whole pixels and between them (SmartProjector), the thesis' T⁺ and this
program's. The figures are decibels of camera PSNR below the best picture that a projector can show there, for a
photograph and a film frame. All of it is simulated.
"""

import argparse
from collections.abc import Iterator
from contextlib import closing
from functools import partial
from pathlib import Path

from counterlight.command import parse_size
from counterlight.tools.colour.tiers import tier_of
from counterlight.tools.shipped import shipped_scenes
from counterlight.tools.simulation.room import simulated_room
from counterlight.tools.simulation.scene import load_scene
from counterlight.tools.simulation.simulate import simulate
from counterlight.tools.study.measure import study_room
from counterlight.tools.study.methods import CUT, DIRECT, PLAIN, TRIANGULATED, Method, Solver
from counterlight.tools.study.pictures import find_pictures
from counterlight.tools.study.results import label
from counterlight.tools.study.rooms import StudyRoom, processor_seconds

SCENE = Path(__file__).with_suffix(".toml")
PICTURES = ("photograph", "film")
METHODS: tuple[Method, ...] = (DIRECT, TRIANGULATED, PLAIN, CUT)
COLUMNS = ("wall", "picture", "best, dB", *(label(each.family, each.knob, each.value) for each in METHODS))


def walls(camera: tuple[int, int], projector: tuple[int, int]) -> Iterator[StudyRoom]:
    """Yield a flat wall, a wall of raised bricks, and a wall of bricks that scatter light inside."""
    flat, stone = (load_scene(path).resized(camera, projector) for path in (shipped_scenes()["wall"], SCENE))
    for name, scene, without in (
        ("flat", flat, ()),
        ("relief", stone, ("inter_reflection", "subsurface")),
        ("relief that scatters", stone, ("inter_reflection",)),
    ):
        done, seconds = processor_seconds(partial(simulate, scene, without=without))
        with closing(StudyRoom(name, tier_of(*simulated_room(scene, [done])), seconds)) as room:
            yield room


def rows(room: StudyRoom) -> Iterator[str]:
    """Yield one row of the table per picture."""
    found = study_room(room, find_pictures(PICTURES), (Solver("box", "box optimum"), *METHODS)).rows
    for picture in PICTURES:
        best, *others = (row for row in found if row.picture == picture)
        below = " | ".join(f"{row.below_optimum_db:.2f}" for row in others)
        yield f"| {room.name} | {picture} | {best.psnr_db:.1f} | {below} |"


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.studies.brickstone", description=__doc__)
    parser.add_argument("--camera", type=parse_size, default=(240, 320), help="camera size (default 320x240)")
    parser.add_argument("--projector", type=parse_size, default=(256, 256), help="projector size (default 256x256)")
    options = parser.parse_args()
    print(f"| {' | '.join(COLUMNS)} |\n{'|---' * len(COLUMNS)}|")
    for room in walls(options.camera, options.projector):
        print(*rows(room), sep="\n", flush=True)


if __name__ == "__main__":
    main()

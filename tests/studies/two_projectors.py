"""Cost of overlap: python -m tests.studies.two_projectors (docs/displays.md).

The scene `wall` is shown under its projector, under a projector at the other side, and under both, which light every
camera pixel. The figures are the white that nine in ten pixels reach, a photograph at two whites, and the cost of T⁺
and the build. All of it is simulated.
"""

import tempfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

import counterlight as cl
from counterlight.pipeline.content import psnr
from counterlight.tools.study.pictures import BUILT_IN
from counterlight.tools.study.rooms import processor_seconds
from tests.joint_rooms import lit_by
from tests.studies.second_projector import WALL_SIDE, pair, shipped

CAMERA, PROJECTOR = (135, 240), (72, 128)
WHITES, STEPS = (0.29, 0.5), (0, 4)


def rooms() -> list[cl.Room]:
    """Returns the room under the first projector, the second, and both."""
    with tempfile.TemporaryDirectory() as name:
        scenes = [each.resized(CAMERA, PROJECTOR) for each in pair(Path(name), shipped("wall"), WALL_SIDE)]
    return [cl.Room(*lit_by(each)) for each in (scenes[:1], scenes[1:], scenes)]


def decibels(room: cl.Room, maps: object, white: float) -> str:
    """Returns PSNR of a photograph after each number of steps."""
    wanted = BUILT_IN["photograph"](room.camera)
    with cl.Renderer(room, maps, backend="cpu", white=white) as renderer:
        errors = [room.seen(renderer.render(wanted, refine=steps)) / white - wanted for steps in STEPS]
    return " / ".join(f"{psnr(float(np.mean(error[room.mask] ** 2))):.1f}" for error in errors) + " dB"


def row(what: str, cells: Sequence[str]) -> None:
    print(f"| {what} | {' | '.join(cells)} |", flush=True)


def main() -> None:
    compared = rooms()
    print("| | first | second | both |\n|---|---|---|---|")
    row("white that nine in ten camera pixels reach (`--white auto`)", [f"{room.white:.3f}" for room in compared])
    built = [processor_seconds(partial(cl.build_maps, room, inverse="whole")) for room in compared]
    for white in WHITES:
        cells = [decibels(room, maps, white) for room, (maps, _) in zip(compared, built, strict=True)]
        row(f"PSNR at white {white:g}, `--refine 0` / `4`", cells)
    row("entries of T⁺ (`--inverse whole`), millions", [f"{maps.correction.count / 1e6:.2f}" for maps, _ in built])
    usual = [processor_seconds(partial(cl.build_maps, room)) for room in compared]
    for what, done in (("counterlight build --inverse whole", built), ("counterlight build", usual)):
        row(f"`{what}`, processor time", [f"{seconds:.0f} s" for _, seconds in done])


if __name__ == "__main__":
    main()

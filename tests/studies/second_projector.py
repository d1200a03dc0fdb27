"""Uses of a second projector: python -m tests.studies.second_projector [PICTURE.png] (docs/displays.md).

The study shows four simulated rooms, each under its first projector, its second projector and both: a shadow that the
other fills, a highlight that the other lights instead, brightness that adds up, and a wall wider than either picture.
Drives are the box optimum. An audience's camera elsewhere, unknown to the product, judges the highlight.
"""

import argparse
import re
import tempfile
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from counterlight.arrays import BoolArray, FloatArray
from counterlight.calibration import Calibration
from counterlight.files.picture_files import write_png
from counterlight.pipeline.content import psnr, reachable_white
from counterlight.response import Response
from counterlight.tools.shipped import shipped_scenes
from counterlight.tools.simulation.scene import Scene, load_scene
from counterlight.tools.solve.box import Box
from counterlight.tools.study.pictures import BUILT_IN
from counterlight.tools.transport.objective import ObjectiveOptions, objective_of
from counterlight.tools.transport.transport import Transport
from tests.camera_rooms import looks_at
from tests.joint_rooms import lit_by

CAMERA, PROJECTOR = (72, 96), (54, 72)
STEPS = 400
WIDTH = 192  # width of each room in the picture
# positions of the second projector
BUST_SIDE, WALL_SIDE, COAT_SIDE = "[-0.6, 0.45, 2.1]", "[-0.5, 0.2, 2.1]", "[-1.4, 0.0, 2.2]"
GREY = 0.5  # as a share of white
COATED = """
[projector]
width = 72
height = 54
position = [0.35, 0.0, 2.2]
look_at = [0.0, 0.0, 0.0]
horizontal_field_of_view_deg = 36
[camera]
width = 96
height = 72
position = [{camera}, 0.0, 2.4]
look_at = [0.0, 0.0, 0.0]
horizontal_field_of_view_deg = 24
[[surfaces]]
name = "varnished board"
corner = [-1.5, -1.0, 0.0]
edge_u = [3.0, 0.0, 0.0]
edge_v = [0.0, 2.0, 0.0]
albedo = [0.62, 0.58, 0.5]
gloss = {{ reflectance = 0.05, roughness = 0.12 }}
"""
CAMERA_X, AUDIENCE_X = -0.35, 0.25
WIDE = """
[projector]
width = 72
height = 54
position = [{projector}, 0.0, 2.0]
look_at = [{projector}, 0.0, 0.0]
horizontal_field_of_view_deg = 40
[camera]
width = 160
height = 54
position = [0.0, 0.0, 3.0]
look_at = [0.0, 0.0, 0.0]
horizontal_field_of_view_deg = 44
[[surfaces]]
name = "long wall"
corner = [-2.0, -1.0, 0.0]
edge_u = [4.0, 0.0, 0.0]
edge_v = [0.0, 2.0, 0.0]
pattern = {{ kind = "bricks", colours = [[0.75, 0.55, 0.45], [0.8, 0.78, 0.72]], repeat = [16, 22], variation = 0.3 }}
"""
Room = tuple[Calibration, Transport]


class Show:
    """A picture in a room: the light of its drive, and its error."""

    def __init__(self, room: Room, wanted: FloatArray, *, avoid: bool = False) -> None:
        self._calibration, self._transport = room
        self._wanted = wanted
        objective = objective_of(self._transport, self._calibration, ObjectiveOptions(avoid_highlights=avoid))
        b = (wanted - self._calibration.ambient).reshape(-1, 3)
        self.drive = Box(objective, most_steps=STEPS).solve(b).drive
        self.seen = seen(room, self.drive)

    def psnr(self, where: BoolArray, white: float) -> float:
        return psnr(float(np.mean(((self.seen - self._wanted)[where] / white) ** 2)))


def seen(room: Room, drive: FloatArray) -> FloatArray:
    calibration, transport = room
    return np.asarray(transport.apply(drive).reshape(calibration.ambient.shape) + calibration.ambient)


def codes(light: FloatArray) -> FloatArray:
    """Returns sRGB code values of light in shares of white."""
    grid = np.linspace(0, 1, 4096)
    return np.asarray(np.interp(light, Response("srgb").to_linear(grid), 255 * grid))


def pair(folder: Path, text: str, second: str) -> list[Scene]:
    """Returns a scene under its projector, and under a projector at `second` that looks at the same place."""
    return [load(folder, each) for each in (text, re.sub(r"position = .*", f"position = {second}", text, count=1))]


def shipped(name: str) -> str:
    return shipped_scenes()[name].read_text()


def white_of(room: Room) -> float:
    calibration, transport = room
    return float(reachable_white(transport.floodlight(calibration.ambient), calibration.mask))


def compared(scenes: Sequence[Scene], *, alone: bool) -> tuple[list[Show], list[Room], float]:
    """Returns a photograph by the first projector, by the second and by both, with their rooms and the white.

    alone : use the white that each projector reaches by itself; otherwise the white of both.
    """
    rooms = [*(lit_by([scene]) for scene in scenes), lit_by(scenes)]
    white = min(map(white_of, rooms)) if alone else white_of(rooms[-1])
    wanted = white * BUILT_IN["photograph"](rooms[0][0].camera.shape)
    return [Show(room, wanted) for room in rooms], rooms, white


def shadow(folder: Path) -> tuple[list[str], list[FloatArray]]:
    """Measure a bust's shadow: pixels that get too little light for mid grey, and PSNR over all lit pixels."""
    scenes = [each.resized(CAMERA, PROJECTOR) for each in pair(folder, shipped("statuette"), BUST_SIDE)]
    shows, rooms, white = compared(scenes, alone=True)
    where = rooms[-1][0].mask
    dark = [100 * np.mean(floodlit(room).min(axis=2)[where] < white / 2) for room in rooms]
    rows = [
        row("shadow: pixels that stay below mid grey, %", dark, "{:.1f}"),
        row("shadow: a photograph, dB", [show.psnr(where, white) for show in shows], "{:.1f}"),
    ]
    return rows, [picture(show.seen, white) for show in shows]


def floodlit(room: Room) -> FloatArray:
    return room[1].floodlight(room[0].ambient)


def brightness(folder: Path) -> tuple[list[str], list[FloatArray]]:
    """Measure the white that nine in ten pixels reach, and a photograph at the white of both."""
    scenes = [each.resized(CAMERA, PROJECTOR) for each in pair(folder, shipped("wall"), WALL_SIDE)]
    shows, rooms, white = compared(scenes, alone=False)
    where = rooms[-1][0].mask
    rows = [
        row("brightness: white that nine in ten pixels reach", [white_of(room) for room in rooms], "{:.3f}"),
        row(f"brightness: a photograph at white {white:.3f}, dB", [s.psnr(where, white) for s in shows], "{:.1f}"),
    ]
    return rows, [picture(show.seen, white) for show in shows]


def wide(folder: Path) -> tuple[list[str], list[FloatArray]]:
    """Measure two overlapping projectors side by side: the share of the view that counts, and a line of grey."""
    scenes = [load(folder, WIDE.format(projector=x)) for x in (-0.55, 0.55)]
    rooms = [lit_by([scenes[0]]), lit_by([scenes[1]]), lit_by(scenes)]
    where, white = rooms[2][0].mask, min(white_of(room) for room in rooms)
    wanted = np.full((*where.shape, 3), GREY * white)
    shows = [Show(room, wanted) for room in rooms]
    lit = [100 * np.mean(room[0].mask[where]) for room in rooms]
    meet = np.flatnonzero((rooms[0][0].mask & rooms[1][0].mask).any(axis=0))
    columns = range(meet[0] - 4, meet[-1] + 5)
    off = [
        max(abs(float(np.median(codes(s.seen / white)[:, c]) - codes(np.array(GREY)))) for c in columns) for s in shows
    ]
    rows = [
        row("a wide wall: of what both light, %", lit, "{:.0f}"),
        row("a wide wall: grey where pictures meet, the worst column off by code values", off, "{:.2f}"),
    ]
    photograph = white * BUILT_IN["photograph"](where.shape)
    return rows, [picture(Show(rooms[i], photograph).seen, white) for i in range(3)]


def highlight(folder: Path) -> tuple[list[str], list[FloatArray]]:
    """Measure grey on a coat inside the first projector's highlight, for the camera and for the audience."""
    pairs = [pair(folder, COATED.format(camera=x), COAT_SIDE) for x in (CAMERA_X, AUDIENCE_X)]
    camera = [lit_by([each]) for each in pairs[0]] + [lit_by(pairs[0])] * 2
    audience = [lit_by([each]) for each in pairs[1]] + [lit_by(pairs[1])] * 2
    white = white_of(camera[1])
    wanted = np.full((*CAMERA, 3), GREY * white)
    shows = [Show(room, wanted, avoid=avoid) for room, avoid in zip(camera, (False, False, False, True), strict=True)]
    bright = floodlit(camera[0])[..., 1]
    spot = bright > 1.3 * np.median(bright)
    there = spots_of(spot, pairs[0][0], pairs[1][0])
    heard = [seen(room, show.drive) for room, show in zip(audience, shows, strict=True)]
    grey = float(codes(np.array(GREY)))
    off = [
        [float(np.median(codes(light / white)[where]) - grey) for light in lights]
        for lights, where in (([show.seen for show in shows], spot), (heard, there))
    ]
    worst = [float(np.percentile(np.abs(codes(light / white)[there] - grey), 95)) for light in heard]
    rows = [
        row("highlight: grey there, the camera's, off by code values", off[0], "{:+.1f}"),
        row("highlight: the audience's, median", off[1], "{:+.1f}"),
        row("highlight: the audience's, 95th percentile", worst, "{:.1f}"),
    ]
    return rows, [picture(light, white) for light in (heard[0], heard[2], heard[3])]


def spots_of(spot: BoolArray, scene: Scene, other: Scene) -> BoolArray:
    """Returns where another camera sees the pixels of `spot`."""
    looks = looks_at(other, scene)
    x, y = (np.clip(looks[..., i].astype(int), 0, spot.shape[1 - i] - 1) for i in (0, 1))
    inside = (looks >= 0).all(axis=2) & (looks[..., 0] < spot.shape[1]) & (looks[..., 1] < spot.shape[0])
    return np.asarray(spot[y, x] & inside)


def load(folder: Path, text: str) -> Scene:
    (folder / "scene.toml").write_text(text)
    return load_scene(folder / "scene.toml")


def row(what: str, values: Sequence[float], form: str) -> str:
    cells = [form.format(value if abs(value) >= 0.05 else 0.0) for value in values] + [""] * (4 - len(values))
    return f"| {what} | {' | '.join(cells)} |"


def picture(light: FloatArray, white: float) -> FloatArray:
    height, width = light.shape[:2]
    size = WIDTH, WIDTH * height // width
    return np.asarray(cv2.resize(codes(light / white), size, interpolation=cv2.INTER_LINEAR))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", choices=("shadow", "brightness", "wide", "highlight"), help="measure only this room")
    parser.add_argument("picture", type=Path, nargs="?", help="draw a row per room into this PNG")
    options = parser.parse_args()
    print("| room: figure | first | second | both | both, `--avoid-highlights` |\n|---|---|---|---|---|")
    drawn = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for room in (shadow, brightness, wide, highlight):
            if options.only not in (None, room.__name__):
                continue
            rows, pictures = room(folder)
            print("\n".join(rows), flush=True)
            drawn.append(np.hstack(pictures))
    if options.picture is not None:
        write_png(options.picture, np.vstack(drawn).round().astype(np.uint8))


if __name__ == "__main__":
    main()

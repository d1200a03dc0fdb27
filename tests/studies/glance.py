"""The README's pictures: python -m tests.studies.glance -o docs makes glance.png and glance.webp.

Four shipped rooms, simulated, built and played as a user does it by default. Each pair is the camera's view at one
exposure: a film frame as any player would project it, and compensated. The clip is the split view of the first room.
"""

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from counterlight.overlay.letters import write
from counterlight.tools.shipped import CLIP
from tests.programs import succeed

ROOMS = {
    "wall": "bricks",
    "corner": "a corner, whose walls light each other",
    "glass": "behind a figure of glass",
    "two_planes": "two planes, one out of focus",
}
CAMERA, PROJECTOR = "240x180", "192x144"
SHOWN_AT_S, FRAMES, RATE = 2.0, 48, 12
GAP, LABEL, INK = 8, 26, 40
Picture = NDArray[np.uint8]


def pair(scene: str, folder: Path) -> Picture:
    """A room before and after, side by side."""
    room = folder / scene
    succeed("simulate", scene, "-o", room, "--camera", CAMERA, "--projector", PROJECTOR)
    succeed("build", room)
    views = []
    for name, options in (("before", ["--no-compensation"]), ("after", ["--refine", "64"])):
        shown = folder / f"{scene}-{name}.png"
        start = "--start", SHOWN_AT_S, "--frames", 1, "--no-config"
        succeed("play", room, CLIP, "--view", "camera", *start, *options, "--output", shown)
        views.append(np.asarray(Image.open(shown).convert("RGB")))
    return beside(views, axis=1)


def beside(pictures: list[Picture], axis: int) -> Picture:
    """Pictures in a row or a column, white between them."""
    shape = list(pictures[0].shape)
    shape[axis] = GAP
    parts = [part for picture in pictures for part in (np.full(shape, 255, np.uint8), picture)]
    return np.concatenate(parts[1:], axis=axis)


def labelled(picture: Picture, words: str) -> Picture:
    """With a line of words above it."""
    ink = Image.new("L", (picture.shape[1], LABEL), 255)
    write(ImageDraw.Draw(ink), (0, LABEL - 9), words, 1.0, INK)
    return np.concatenate([np.repeat(np.asarray(ink)[..., None], 3, axis=2), picture])


def sheet(folder: Path) -> Picture:
    pairs = [labelled(pair(scene, folder), words) for scene, words in ROOMS.items()]
    return beside([beside(pairs[:2], axis=1), beside(pairs[2:], axis=1)], axis=0)


def clip(folder: Path, path: Path) -> None:
    """The split view: left as any player would, right compensated."""
    room = folder / next(iter(ROOMS))
    options = "--view", "split", "--no-config", "--frames", FRAMES, "--refine", 16
    succeed("play", room, CLIP, *options, "--output", folder / "split-%03d.png")
    shown = sorted(folder.glob("split-*.png"))[::2]
    first, *rest = (Image.open(each).convert("RGB") for each in shown)
    first.save(path, save_all=True, append_images=rest, duration=1000 // RATE, loop=0, quality=60, method=6)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=Path(), metavar="FOLDER")
    output = parser.parse_args().output
    with TemporaryDirectory() as made:
        Image.fromarray(sheet(Path(made))).save(output / "glance.png", optimize=True)
        clip(Path(made), output / "glance.webp")


if __name__ == "__main__":
    main()

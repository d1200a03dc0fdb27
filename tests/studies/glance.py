"""The README's pictures: python -m tests.studies.glance -o docs makes glance.png and hero.webp.

Four shipped rooms are simulated, built and played with the defaults. Each pair is the camera's view at one exposure: a
film frame as any player would project it, and compensated. The clip wipes between both in the first room.
"""

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

import av
import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw
from scipy import sparse

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
WIDE, WIDE_PROJECTOR = "960x540", "768x432"  # sizes for the clip
SHOWN_AT_S, FRAMES, SKIPPED, SHOWN_MS = 2.0, 44, 3, 120  # every third frame of a clip of 25 per second is shown
GAP, LABEL, INK, WHITE = 8, 26, 40, 0xFFFFFF
Picture = NDArray[np.uint8]


def pair(scene: str, folder: Path) -> Picture:
    """Returns a room before and after, side by side."""
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
    """Join pictures in a row or a column, with white between them."""
    shape = list(pictures[0].shape)
    shape[axis] = GAP
    parts = [part for picture in pictures for part in (np.full(shape, 255, np.uint8), picture)]
    return np.concatenate(parts[1:], axis=axis)


def labelled(picture: Picture, words: str) -> Picture:
    """Add a line of text above a picture."""
    ink = Image.new("L", (picture.shape[1], LABEL), 255)
    write(ImageDraw.Draw(ink), (0, LABEL - 9), words, 1.0, INK)
    return np.concatenate([np.repeat(np.asarray(ink)[..., None], 3, axis=2), picture])


def sheet(folder: Path) -> Picture:
    pairs = [labelled(pair(scene, folder), words) for scene, words in ROOMS.items()]
    return beside([beside(pairs[:2], axis=1), beside(pairs[2:], axis=1)], axis=0)


def hero(folder: Path, path: Path) -> None:
    """Write a clip of the first room that wipes from the uncompensated, pinned picture to the compensated picture."""
    room = folder / "hero"
    succeed("simulate", next(iter(ROOMS)), "-o", room, "--camera", WIDE, "--projector", WIDE_PROJECTOR)
    succeed("build", room)
    pin(room, folder)
    pinned = folder / "pinned-%03d.png", "--fps", 25, "--no-compensation"
    for name, medium in (("before", pinned), ("after", (CLIP, "--frames", FRAMES * SKIPPED))):
        shown = "--view", "camera", "--no-config", "--output", folder / f"{name}-%03d.png"
        succeed("play", room, *medium, *shown)
    pairs = zip(*(sorted(folder.glob(f"{name}-*.png"))[::SKIPPED] for name in ("before", "after")), strict=True)
    first, *rest = [wiped(before, after, number / FRAMES) for number, (before, after) in enumerate(pairs)]
    first.save(path, save_all=True, append_images=rest, duration=SHOWN_MS, loop=0, quality=50, method=4)


def pin(room: Path, folder: Path) -> None:
    """Write the clip's frames, warped so that they fill the camera's view when they are projected uncompensated."""
    near = sparse.load_npz(room / "transport_green.npz").tocsr()
    size, (width, _) = (tuple(map(int, words.split("x"))) for words in (WIDE, WIDE_PROJECTOR))
    seen = np.flatnonzero(np.diff(near.indptr))[::97]
    place = np.stack(np.divmod(np.arange(near.shape[1]), width)[::-1], axis=1)
    centres = (near[seen] @ place) / near[seen].sum(axis=1)[:, None]
    to_projector, _ = cv2.findHomography(np.stack(np.divmod(seen, size[0])[::-1], axis=1) * 1.0, centres, cv2.RANSAC)
    raster = tuple(map(int, WIDE_PROJECTOR.split("x")))
    with av.open(str(CLIP)) as container:
        for number, frame in zip(range(FRAMES * SKIPPED), container.decode(video=0), strict=False):
            fitted = cv2.resize(frame.to_ndarray(format="bgr24"), size, interpolation=cv2.INTER_AREA)
            cv2.imwrite(str(folder / f"pinned-{number + 1:03d}.png"), cv2.warpPerspective(fitted, to_projector, raster))


def wiped(before: Path, after: Path, time: float) -> Image.Image:
    """Draw any player's picture left of a line, and the compensated picture right of it.

    time : from 0 to 1.
    """
    left, right = (np.asarray(Image.open(path).convert("RGB")) for path in (before, after))
    line = round(left.shape[1] * (0.5 + 0.45 * np.cos(2 * np.pi * time)))
    picture = Image.fromarray(np.concatenate([left[:, :line], right[:, line:]], axis=1))
    draw = ImageDraw.Draw(picture)
    draw.line([(line, 0), (line, picture.height)], fill=WHITE, width=3)
    for words, x in (("any player", 16), ("Counterlight", picture.width - 212)):
        draw.rectangle((x - 8, 12, x + 204, 48), fill="black")
        write(draw, (x, 38), words, 2.0, WHITE)
    return picture


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=Path(), metavar="FOLDER")
    output = parser.parse_args().output
    with TemporaryDirectory() as made:
        Image.fromarray(sheet(Path(made))).save(output / "glance.png", optimize=True)
        hero(Path(made), output / "hero.webp")


if __name__ == "__main__":
    main()

"""A show next to itself without its watcher, as an animation: what the calibrated camera sees, at one exposure."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from matplotlib.font_manager import findfont
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from tests.rig.live import Show, Unwatched, unwatched

SIDE, GAP, BAR = 480, 8, 34  # pixels: width of a picture, between the two, height of the labels
SHOWN_MS, QUALITY = 200, 60
INK, PAPER, LETTERS = 40, 255, 22
RUNS_S, FRAMES, EVERY_S = (0, 22, 44, 66, 88), 8, 1 / 8  # four loops of the clip take 22 s
MOMENTS = [start + number * EVERY_S for start in RUNS_S for number in range(FRAMES)]


def animate(show: Show, path: Path) -> None:
    """Write the pictures that the show displayed right of the same film frames without a watcher."""
    first, *rest = _pictures(show)
    first.save(path, save_all=True, append_images=rest, duration=SHOWN_MS, loop=0, quality=QUALITY, method=6)


def _pictures(show: Show) -> Iterator[Image.Image]:
    for each in unwatched(show):
        right, down = each.judge.rig.devices.shift
        moved = f"after {each.seen.time_s:.0f} s the picture has moved by {np.hypot(right, down):.2f} pixels"
        sides = [
            _labelled(_seen(each, codes, show.white), f"{name}: {each.psnr(codes):.1f} dB")
            for name, codes in (("without the watcher", each.codes), ("with the watcher", each.seen.codes))
        ]
        gap = np.full((sides[0].shape[0], GAP, 3), PAPER, np.uint8)
        yield Image.fromarray(np.concatenate([np.concatenate([sides[0], gap, sides[1]], axis=1), _bar(moved)]))


def _seen(each: Unwatched, codes: NDArray[np.uint8], white: float) -> NDArray[np.uint8]:
    """Return the camera picture, cut to the film's 16:9."""
    height, width = each.judge.rig.camera
    seen = each.judge.srgb(each.judge.rig.seen(codes), white).reshape(height, width, 3)
    top = (height - width * 9 // 16) // 2
    cut = Image.fromarray(np.ascontiguousarray(seen[top : height - top]))
    return np.asarray(cut.resize((SIDE, SIDE * cut.height // width), Image.Resampling.LANCZOS))


def _labelled(picture: NDArray[np.uint8], words: str) -> NDArray[np.uint8]:
    return np.concatenate([_bar(words, SIDE), picture])


def _bar(words: str, width: int = 2 * SIDE + GAP) -> NDArray[np.uint8]:
    ink = Image.new("L", (width, BAR), PAPER)
    font = ImageFont.truetype(findfont("DejaVu Sans"), LETTERS)
    ImageDraw.Draw(ink).text((4, BAR - 11), words, INK, font, anchor="ls")
    return np.repeat(np.asarray(ink)[..., None], 3, axis=2)

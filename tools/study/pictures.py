"""The pictures of a study: built-in pictures that represent projected content, or the user's own files."""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from skimage import data

from counterlight.arrays import FloatArray
from counterlight.errors import InputError
from counterlight.media.video import MediaReader
from counterlight.passes.planes_to_linear import planes_to_linear
from counterlight.pipeline.signal import signal_of
from counterlight.response import Response
from counterlight.show.headless import FRAME_TIMEOUT_S
from counterlight.tools.relighting.pictures import read_placed
from counterlight.tools.shipped import CLIP

Shape = tuple[int, int]
CLIP_SIZE = (720, 1280)
FILM_FROM_S = 1.0
FACE = 0.05  # share of the cropped rows that are cropped at the top of the photograph
DARK = 1 / 8  # a darkening by three stops
PAPER, INK = 0.02, 0.9  # share of white, linear: light letters on dark ground
LETTERING = "Light is the first of painters. There is no object so foul that intense light will not make beautiful."
LINES_A_PAGE = 6
OVERSAMPLING = 8
BAND = 32 * OVERSAMPLING  # rows of the large drawing that are converted to float at a time


@dataclass(frozen=True)
class Picture:
    """A named picture at any size: at((height, width)) returns (height, width, 3), linear, 0..1."""

    name: str
    at: Callable[[Shape], FloatArray]


def find_pictures(names: Sequence[str]) -> list[Picture]:
    """Returns built-in pictures by name, and others from files. Raises InputError for unknown names."""
    return [Picture(name, BUILT_IN[name]) if name in BUILT_IN else _from_file(name) for name in names]


def film_frames(count: int) -> list[Picture]:
    """Returns `count` consecutive frames of one shot of the shipped clip."""
    lights = _film_lights(count)
    return [Picture(f"frame {number}", partial(_filled, light)) for number, light in enumerate(lights, 1)]


@cache
def _film_lights(count: int) -> list[FloatArray]:
    lights: list[FloatArray] = []
    with MediaReader.open(CLIP) as reader:
        reader.seek(FILM_FROM_S)
        while len(lights) < count and (frame := reader.next_frame(FRAME_TIMEOUT_S)) is not None:
            light = planes_to_linear(frame.planes, frame.format, signal_of(frame.format))
            lights.append(np.asarray(light, np.float64))
            reader.release(frame)
    return lights


def anywhere(names: Sequence[str]) -> tuple[str, ...]:
    """Returns the names with absolute paths, so that they mean the same pictures in any folder."""
    return tuple(name if name in BUILT_IN else os.path.abspath(name) for name in names)


def _from_file(name: str) -> Picture:
    path = Path(name)
    if not path.exists():
        raise InputError(f"--pictures {name}: no such file, and none of the built-in {', '.join(BUILT_IN)}")
    if path.suffix.lower() == ".exr":
        raise InputError(f"{path}: OpenEXR is radiance of one room, a study shows its pictures in many; save it as PNG")
    read_placed(path, (16, 16))  # refuses unreadable files early
    return Picture(path.stem, lambda shape: read_placed(path, shape))


def _photograph(shape: Shape) -> FloatArray:
    """Eileen Collins by NASA, in the public domain; the picture comes with scikit-image."""
    return _filled(_photograph_light(), shape, from_top=FACE)


def _film(shape: Shape) -> FloatArray:
    return _filled(_film_light(), shape)


def _dark_film(shape: Shape) -> FloatArray:
    return DARK * _film(shape)


@cache
def _photograph_light() -> FloatArray:
    codes = data.astronaut()  # type: ignore[no-untyped-call]
    return Response("srgb").to_linear(codes / 255)


@cache
def _film_light() -> FloatArray:
    return read_placed(CLIP, CLIP_SIZE)


def _text(shape: Shape) -> FloatArray:
    """Returns lines of text, drawn large and averaged down."""
    height, width = (OVERSAMPLING * side for side in shape)
    step = height // LINES_A_PAGE
    page = np.zeros((height, width), np.uint8)
    scale = 0.6 * step / 22  # Hershey's simplex capitals are 21 pixels high at scale 1
    thick = max(1, step // 12)
    words, row = iter(LETTERING.split() * 4), 0
    line = next(words)
    for word in words:
        if cv2.getTextSize(f"{line} {word}", cv2.FONT_HERSHEY_SIMPLEX, scale, thick)[0][0] < 0.94 * width:
            line = f"{line} {word}"
            continue
        at = width // 50, row * step + int(0.78 * step)
        cv2.putText(page, line, at, cv2.FONT_HERSHEY_SIMPLEX, scale, 255, thick, cv2.LINE_AA)
        line, row = word, row + 1
        if row == LINES_A_PAGE:
            break
    small = np.concatenate([_averaged_down(page[top : top + BAND]) for top in range(0, height, BAND)])
    return np.repeat((PAPER + (INK - PAPER) * small)[..., None], 3, axis=2)


def _averaged_down(rows: NDArray[np.uint8]) -> FloatArray:
    """Returns the means of OVERSAMPLING × OVERSAMPLING pixels as shares of white."""
    height, width = (side // OVERSAMPLING for side in rows.shape)
    return np.asarray(cv2.resize(rows / 255, (width, height), interpolation=cv2.INTER_AREA))


def _gradient(shape: Shape) -> FloatArray:
    """Returns black to white from left to right; warm at the top, cold at the bottom."""
    height, width = shape
    ramp = ((np.arange(width) + 0.5) / width)[None, :, None]
    cold = ((np.arange(height) + 0.5) / height)[:, None, None]
    return np.asarray(ramp * (1 - np.array([0.3, 0.1, 0.0]) * cold - np.array([0.0, 0.1, 0.3]) * (1 - cold)))


def _white(shape: Shape) -> FloatArray:
    return np.ones((*shape, 3))


def _filled(linear: FloatArray, shape: Shape, from_top: float = 0.5) -> FloatArray:
    """Crop a picture to the aspect ratio of a shape and resize it: averaged down, or interpolated up.

    from_top : share of the cropped rows that are cropped at the top.
    """
    height, width = linear.shape[:2]
    scale = min(height / shape[0], width / shape[1])
    rows, columns = round(scale * shape[0]), round(scale * shape[1])
    top, left = round(from_top * (height - rows)), (width - columns) // 2
    kind = cv2.INTER_AREA if scale > 1 else cv2.INTER_LINEAR
    part = np.ascontiguousarray(linear[top : top + rows, left : left + columns])
    return np.clip(np.asarray(cv2.resize(part, shape[::-1], interpolation=kind), np.float64), 0, 1)


BUILT_IN: dict[str, Callable[[Shape], FloatArray]] = {
    "photograph": _photograph,
    "text": _text,
    "gradient": _gradient,
    "white": _white,
    "dark-film": _dark_film,
    "film": _film,
}

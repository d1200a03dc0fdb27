"""Fit pictures into a frame, and write pictures as PNG or OpenEXR."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray
from counterlight.errors import InputError
from counterlight.files import exr
from counterlight.files.picture_files import write_png
from counterlight.media.video import MediaReader
from counterlight.passes.encode import encoded as encode
from counterlight.passes.pinned import pinned
from counterlight.passes.planes_to_linear import planes_to_linear
from counterlight.passes.resample import resample
from counterlight.pipeline.placement import corners_of, homography, place, shown_shape
from counterlight.pipeline.signal import signal_of
from counterlight.response import Response
from counterlight.screen import Screen
from counterlight.show.headless import FRAME_TIMEOUT_S

SUFFIXES = (".png", ".exr")
WHITE_PERCENTILE = 99.0


def read_placed(path: Path, target: tuple[int, int], screen: Screen | None = None) -> FloatArray:
    """Read the first picture of a medium in linear light, fitted into a frame (height, width) as the player fits it.

    OpenEXR is linear already and is read pixel by pixel.

    screen : screen that several cameras share; None for a single camera.

    Raises InputError for unreadable media, and for OpenEXR of another size than the frame.
    """
    with MediaReader.open(path) as reader:
        frame = reader.next_frame(FRAME_TIMEOUT_S)
        if frame is None:
            raise InputError(f"{path}: holds no picture; export it again")
        pixels = frame.format
        found = pixels.height, pixels.width
        if pixels.layout == "radiance" and found != target:
            raise InputError(
                f"{path}: an OpenEXR picture of {found[1]}x{found[0]} pixels, expected {target[1]}x{target[0]}: it is "
                "taken pixel by pixel, so resize it or save it as PNG"
            )
        linear = planes_to_linear(frame.planes, pixels, signal_of(pixels))
        reader.release(frame)
    if screen is not None and pixels.layout != "radiance":
        H = homography(corners_of(place(pixels, screen.shape), screen.shape), screen.shape, shown_shape(pixels))
        return np.asarray(pinned(linear, target, H, *screen.axes), np.float64)
    spot = place(pixels, target)
    placed = resample(linear, target, (spot.left, spot.top, spot.width, spot.height))
    return np.asarray(placed, np.float64)


def white_level(linear_rgb: FloatArray) -> float:
    """Returns the first positive number of: the 99th percentile of a picture's values, their maximum, and 1."""
    level = float(np.percentile(linear_rgb, WHITE_PERCENTILE))
    largest = float(np.max(linear_rgb))
    return level if level > 0 else largest if largest > 0 else 1.0


def encoded(linear_rgb: FloatArray, white: float) -> NDArray[np.uint8]:
    """Returns 8-bit sRGB with `white` at 255; values below 0 and above white are clipped."""
    return encode(linear_rgb, Response("srgb").over(linear_rgb.shape[:2]), white)


def write_view(path: Path, linear_rgb: FloatArray, white: float) -> None:
    """Write a picture: PNG as sRGB with `white` at 255, OpenEXR with the linear values."""
    if path.suffix.lower() == ".exr":
        exr.write_rgb(path, linear_rgb.astype(np.float32))
    else:
        write_png(path, encoded(linear_rgb, white))

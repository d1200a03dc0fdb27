"""OpenEXR files as named channels: the only importer of OpenEXR.

The library opens truncated files without a word, so the header is checked against limits before pixels are decoded,
and callers that need the pixels to be right compare a checksum first (player/files.py).
"""

import errno
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from numpy.typing import NDArray

from player.errors import InputError

MAX_PIXELS = 1 << 28  # 16384², the largest 2D texture of common GPUs
_HEADER = {
    "compression": OpenEXR.ZIP_COMPRESSION,
    "type": OpenEXR.scanlineimage,
}  # ZIP: lossless, read by every version


@dataclass(frozen=True)
class Header:
    """What a file claims before its pixels are decoded: display window size and channel names."""

    height: int
    width: int
    channels: tuple[str, ...]


def write_channels(path: Path, channels: Mapping[str, NDArray[Any]]) -> None:
    """Write channels of equal shape (rows, columns), float32 or uint32, losslessly; OSError if the system refuses."""
    # `write` replaces the arrays of the dictionary it gets and misreads strided ones: hence a fresh one, contiguous.
    contiguous = {name: np.ascontiguousarray(values) for name, values in channels.items()}
    with OpenEXR.File(dict(_HEADER), contiguous) as file:
        try:
            file.write(str(path))
        except RuntimeError as error:
            reason = _one_line(error).rpartition('". ')[2].rstrip(".")  # after the name of the file
            raise OSError(errno.EIO, reason, str(path)) from None


def write_rgb(path: Path, linear_rgb: NDArray[np.float32]) -> None:
    """Write a picture (rows, columns, 3)."""
    write_channels(path, {name: linear_rgb[..., i].astype(np.float32) for i, name in enumerate("RGB")})


def read_header(path: Path) -> Header:
    """Sizes and channels of a file; InputError if it is no EXR picture or larger than 2²⁸ pixels."""
    try:
        with OpenEXR.File(str(path), separate_channels=True, header_only=True) as file:
            header = dict(file.header())  # the file's own is emptied when it closes
            names = tuple(sorted(channel.name for channel in header["channels"]))
            height, width = _window_size(header["displayWindow"])
            data_height, data_width = _window_size(header["dataWindow"])
    except Exception as error:  # the binding raises bare RuntimeError, ValueError and others
        raise InputError(f"{path}: not a readable OpenEXR file ({_one_line(error)}); export it again") from None
    if min(height, width, data_height, data_width) < 1 or max(height * width, data_height * data_width) > MAX_PIXELS:
        raise InputError(f"{path}: claims {width}x{height} pixels, at most {MAX_PIXELS} are read; is the file damaged?")
    return Header(height, width, names)


def read_channels(path: Path) -> dict[str, NDArray[Any]]:
    """Decode every channel (rows, columns) as it is stored, placed in the display window (0 outside its data)."""
    shape = read_header(path)
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            header = dict(file.header())
            stored = {name: np.asarray(channel.pixels) for name, channel in file.channels().items()}
    except Exception as error:
        raise InputError(f"{path}: its pixels cannot be decoded ({_one_line(error)}); export it again") from None
    return {name: _in_display_window(pixels, header, shape, path) for name, pixels in stored.items()}


def read_rgb(path: Path) -> NDArray[np.float32]:
    """Read the channels R, G and B, or Y alone, as a float32 picture (rows, columns, 3)."""
    names = read_header(path).channels
    wanted = ("R", "G", "B") if {"R", "G", "B"} <= set(names) else ("Y", "Y", "Y")
    if wanted[0] not in names:
        raise InputError(f"{path}: channels {', '.join(names)}, expected R, G and B (or Y); export it as RGB")
    channels = read_channels(path)
    return np.stack([channels[name].astype(np.float32) for name in wanted], axis=-1)


def _window_size(window: tuple[NDArray[np.int32], NDArray[np.int32]]) -> tuple[int, int]:
    (x0, y0), (x1, y1) = ((int(corner[0]), int(corner[1])) for corner in window)
    return y1 - y0 + 1, x1 - x0 + 1


def _in_display_window(pixels: NDArray[Any], header: dict[str, Any], shape: Header, path: Path) -> NDArray[Any]:
    if pixels.shape != _window_size(header["dataWindow"]):
        raise InputError(f"{path}: its channels are subsampled or incomplete; export it with full-size channels")
    left, top = (int(d - s) for d, s in zip(header["dataWindow"][0], header["displayWindow"][0], strict=True))
    if (left, top) == (0, 0) and pixels.shape == (shape.height, shape.width):
        return pixels
    placed = np.zeros((shape.height, shape.width), pixels.dtype)
    rows = slice(max(top, 0), min(top + pixels.shape[0], shape.height))
    columns = slice(max(left, 0), min(left + pixels.shape[1], shape.width))
    if rows.start < rows.stop and columns.start < columns.stop:
        placed[rows, columns] = pixels[rows.start - top : rows.stop - top, columns.start - left : columns.stop - left]
    return placed


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__

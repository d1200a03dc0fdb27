"""OpenEXR files as named channels. This is the only importer of OpenEXR.

Uncompressed files, such as maps, are written and read in pieces without the library (exr_lines.py). The library opens
truncated files without an error. Therefore the header is checked against limits before pixels are decoded
(exr_header.py), and callers that need exact pixels compare a checksum first (reading.py).
"""

import errno
import io
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass
from io import BufferedReader
from math import prod
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import OpenEXR
from numpy.typing import NDArray

from counterlight import memory
from counterlight.errors import InputError, one_line, shown
from counterlight.files import exr_lines
from counterlight.files.exr_header import MAX_PIXELS, Part, read_parts
from counterlight.files.reading import DescribedFiles, Source, opened
from counterlight.files.silence import silence

MAX_SURPLUS_BYTES = 1 << 30  # most bytes of unwanted channels that may be decoded along with wanted ones
FIX = "export it again"
_HEADER = {
    "compression": OpenEXR.ZIP_COMPRESSION,
    "type": OpenEXR.scanlineimage,
}  # ZIP is lossless, and every version reads it


@dataclass(frozen=True)
class Header:
    """Claims of a file, known before its pixels are decoded: size of the display window, and channel names."""

    height: int
    width: int
    channels: tuple[str, ...]


Acceptance: TypeAlias = Callable[[Header, str], None]  # raises InputError, naming the file, to refuse a header
Look: TypeAlias = Callable[[NDArray[Any]], None]  # raises InputError to refuse rows, (rows, columns, channels)


def write_channels(path: Path, channels: Mapping[str, NDArray[Any]]) -> None:
    """Write channels (rows, columns) of equal shape, float32 or uint32, losslessly. Raises OSError on failure."""
    # `write` replaces the arrays of its dictionary and misreads strided arrays. Hence a new dictionary of contiguous
    # arrays.
    contiguous = {name: np.ascontiguousarray(values) for name, values in channels.items()}
    with OpenEXR.File(dict(_HEADER), contiguous) as file:
        try:
            file.write(str(path))
        except RuntimeError as error:
            reason = str(error).rpartition('". ')[2].rstrip(".")  # the text after the file's name
            raise OSError(errno.EIO, one_line(reason), str(path)) from None


def write_rgb(path: Path, linear_rgb: NDArray[np.float32]) -> None:
    """Write a picture (rows, columns, 3)."""
    write_channels(path, rgb(linear_rgb.astype(np.float32)))


def rgb(picture: NDArray[Any]) -> dict[str, NDArray[Any]]:
    """Return a picture (rows, columns, 3) as channels."""
    return {name: picture[..., i] for i, name in enumerate("RGB")}


def write_plain(path: Path, channels: Mapping[str, NDArray[Any]]) -> None:
    """Write channels of equal shape and type, float32 or uint32, uncompressed and in pieces."""
    exr_lines.write(path, channels)


def read_stacked(
    source: Source,
    names: tuple[str, ...],
    accept: Acceptance = lambda header, name: None,
    look: Look = lambda rows: None,
    most: int = MAX_PIXELS,
) -> NDArray[Any]:
    """Decode some channels into one array (rows, columns, names), with the type of the first channel.

    source : a path or an open file.
    names : names of the channels.
    accept : may refuse the header.
    look : may refuse rows; called with pieces of rows as soon as they are read.
    most : most pixels that are read.
    """
    with opened(source, FIX) as file:
        parts = _parts(file, most)
        accept(_header(parts[0]), file.name)
        return _stacked(file, parts, names, look)


def read_channels(source: Source) -> dict[str, NDArray[Any]]:
    """Decode every channel (rows, columns) with its stored type, placed in the display window (0 outside its data)."""
    with opened(source, FIX) as file:
        parts = _parts(file)
        return _decoded(file, parts, parts[0].channels)


def read_rgb(source: Source, accept: Acceptance = lambda header, name: None) -> NDArray[np.float32]:
    """Read channels R, G and B, or Y alone, as a float32 picture (rows, columns, 3); see `read_channels`."""
    with opened(source, FIX) as file:
        parts = _parts(file)
        names = parts[0].channels
        wanted = ("R", "G", "B") if {"R", "G", "B"} <= set(names) else ("Y", "Y", "Y")
        if wanted[0] not in names:
            expected = "expected R, G and B (or Y); export it as RGB"
            raise InputError(f"{file.name}: channels {shown(names)}, {expected}")
        accept(_header(parts[0]), file.name)
        return _stacked(file, parts, wanted).astype(np.float32, copy=False)


def read_described(files: DescribedFiles, name: str, shape: tuple[int, int], whose: str) -> NDArray[np.float32]:
    """Read a picture of a folder whose files are described by a table. Its (height, width) must be `shape`.

    whose : names the owner of `shape` in the message, such as "the camera".
    """
    with files.opened(files.folder / name) as file:
        return read_rgb(file, sized(shape, whose, files.fix))


def sized(shape: tuple[int, int], whose: str, fix: str) -> Acceptance:
    """Return a check that accepts only pictures of (height, width) `shape`.

    whose : names the owner of `shape` in the message, such as "the camera".
    """

    def accept(header: Header, name: str) -> None:
        if (header.height, header.width) != shape:
            raise InputError(f"{name}: {header.width}x{header.height}, {whose} is {shape[1]}x{shape[0]}; {fix}")

    return accept


def _parts(file: BufferedReader, most: int = MAX_PIXELS) -> list[Part]:
    with _unreadable(file):
        return read_parts(file, most)


@contextmanager
def _unreadable(file: BufferedReader) -> Iterator[None]:
    """Convert a ValueError into an InputError about the file."""
    try:
        yield
    except ValueError as error:
        raise InputError(f"{file.name}: not a readable OpenEXR file ({error}); {FIX}") from None


def _header(part: Part) -> Header:
    return Header(*part.shape, part.channels)


def _stacked(
    file: BufferedReader, parts: list[Part], names: tuple[str, ...], look: Look = lambda rows: None
) -> NDArray[Any]:
    """Read channels into one array, without the library where that is possible."""
    with _unreadable(file):
        lines = exr_lines.lines_of(file, parts[0]) if len(parts) == 1 else None
    if lines is None:
        channels = _decoded(file, parts, names)
        together = np.empty((*parts[0].shape, len(names)), np.result_type(*channels.values()))
        for i, name in enumerate(names):
            together[..., i] = channels[name]
        look(together)
        return together
    places = [parts[0].channels.index(name) for name in names]
    memory.check(len(names) * 4 * prod(parts[0].shape), f"{file.name}: reading it", "scale it down")
    together = np.empty((*parts[0].shape, len(names)), lines.dtype)
    with _unreadable(file):
        for rows, values in lines.read(file):
            for i, place in enumerate(places):
                together[rows, :, i] = values[:, place]
            look(together[rows])
    return together


def _decoded(file: BufferedReader, parts: list[Part], wanted: tuple[str, ...]) -> dict[str, NDArray[Any]]:
    """Decode the wanted channels of the first part. The library decodes all channels of all parts."""
    total = sum(part.nbytes for part in parts)
    surplus = len(parts) > 1 or set(parts[0].channels) - set(wanted)
    if surplus and total > MAX_SURPLUS_BYTES:
        count = sum(len(part.channels) for part in parts)
        raise InputError(
            f"{file.name}: {count} channels of {total / 2**30:.1f} GiB in all, at most {MAX_SURPLUS_BYTES >> 30} GiB "
            f"are decoded; export {', '.join(sorted(set(wanted)))} alone"
        )
    memory.check(total + 4 * len(wanted) * prod(parts[0].shape), f"{file.name}: decoding it", "scale it down")
    stored = _library_channels(file)
    data = parts[0].data
    shape = data[3] - data[1] + 1, data[2] - data[0] + 1
    if any(name not in stored or stored[name].shape != shape for name in wanted):
        raise InputError(f"{file.name}: its channels are incomplete; {FIX}")
    return {name: _in_display_window(stored[name], parts[0]) for name in wanted}


def _library_channels(file: BufferedReader) -> dict[str, NDArray[Any]]:
    """Decode with the library, which prints errors about pixels and continues without them."""
    file.seek(0)
    said = io.StringIO()
    try:
        with silence(), redirect_stdout(said), OpenEXR.File(file, separate_channels=True) as picture:
            return {name: np.asarray(channel.pixels) for name, channel in picture.channels().items()}
    except Exception as error:  # the binding raises RuntimeError, ValueError and other exceptions
        reason = one_line(said.getvalue().rpartition(" - ")[2] or error)
        raise InputError(f"{file.name}: its pixels cannot be decoded ({reason}); {FIX}") from None


def _in_display_window(pixels: NDArray[Any], part: Part) -> NDArray[Any]:
    height, width = part.shape
    left, top = part.data[0] - part.display[0], part.data[1] - part.display[1]
    if (left, top) == (0, 0) and pixels.shape == (height, width):
        return pixels
    placed = np.zeros((height, width), pixels.dtype)
    rows = slice(max(top, 0), min(top + pixels.shape[0], height))
    columns = slice(max(left, 0), min(left + pixels.shape[1], width))
    if rows.start < rows.stop and columns.start < columns.stop:
        placed[rows, columns] = pixels[rows.start - top : rows.stop - top, columns.start - left : columns.stop - left]
    return placed

"""Reads the header of an OpenEXR file before the library does (openexr.com, "OpenEXR File Layout").

The library allocates memory for what a header claims: a table with an entry per chunk, a buffer per chunk, every
channel of every part. A file of 400 bytes can claim gigabytes. This module refuses such files, and deep pixels.
"""

import os
import struct
from dataclasses import dataclass
from math import ceil
from typing import BinaryIO

MAX_PIXELS = 1 << 28  # number of pixels of a 16384² texture, the largest 2D texture of common GPUs
MOST_PIXELS = 1 << 30  # limit for Counterlight's own files, which are read in pieces (exr_lines.py)
MAGIC, TILED, DEEP, MULTIPART = 20000630, 0x200, 0x800, 0x1000
LONGEST_NAME, MOST_PARTS, MOST_ATTRIBUTES, MOST_CHANNELS = 255, 64, 1024, 1024
MAX_ATTRIBUTE_BYTES = 64 << 20  # limit of all attributes; previews and lists of picture contents are long
MAX_CHUNK_BYTES = 1 << 30
FARTHEST = 1 << 24  # largest distance of a window from the origin, in pixels
# lines per chunk, by number of the compression; at most MOST_LINES for other compressions
LINES = {0: 1, 1: 1, 2: 1, 3: 16, 4: 32, 5: 16, 6: 32, 7: 32, 8: 32}
MOST_LINES = 256
BYTES = {0: 4, 1: 2, 2: 4}  # bytes per value of a channel: UINT, HALF, FLOAT
UINT, FLOAT = 0, 2
PLAIN = b"\0"  # value that means "no compression", and "lines from the top"

Window = tuple[int, int, int, int]


@dataclass(frozen=True)
class Part:
    """One picture of a file.

    display : window (x0, y0, x1, y1), with both ends inside.
    data : window (x0, y0, x1, y1), with both ends inside.
    channels : names, sorted.
    pixel_bytes : bytes of one pixel in all channels.
    plain : kind of the values (UINT or FLOAT) if all lines are uncompressed, from the top, and fill the display window;
        None otherwise.
    """

    display: Window
    data: Window
    channels: tuple[str, ...]
    pixel_bytes: int
    plain: int | None

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width) of the display window."""
        return _shape(self.display)

    @property
    def nbytes(self) -> int:
        """Bytes of the decoded part."""
        height, width = _shape(self.data)
        return height * width * self.pixel_bytes


def read_parts(file: BinaryIO, most: int = MAX_PIXELS) -> list[Part]:
    """Return the parts of a file that is open at its beginning. Raises ValueError for no picture or excessive sizes.

    A file with a single part is left at the end of its header.

    most : pixels of a window.
    """
    size = os.fstat(file.fileno()).st_size
    magic, version = struct.unpack("<II", _take(file, 8))
    if magic != MAGIC or version & 0xFF != 2:
        raise ValueError("not an OpenEXR file of version 2")
    if version & DEEP:
        raise ValueError("it holds deep pixels; flatten them")
    parts: list[Part] = []
    left = MAX_ATTRIBUTE_BYTES
    while attributes := _attributes(file, min(left, size)):
        left -= sum(map(len, attributes.values()))
        parts.append(_part(attributes, tiled=bool(version & TILED), size=size, most=most))
        if not version & MULTIPART:
            return parts
        if len(parts) > MOST_PARTS:
            raise ValueError(f"more than {MOST_PARTS} parts")
    if not parts:
        raise ValueError("it holds no picture")
    return parts


def _attributes(file: BinaryIO, most: int) -> dict[str, bytes]:
    """Return name -> value of one header, empty at the end of the headers."""
    found: dict[str, bytes] = {}
    while name := _name(file):
        _name(file)  # skips the attribute's type, which the library checks
        (length,) = struct.unpack("<i", _take(file, 4))
        if not 0 <= length <= most or name in found or len(found) >= MOST_ATTRIBUTES:
            raise ValueError("its header is damaged or too long")
        most -= length
        found[name] = _take(file, length)
    return found


def _part(attributes: dict[str, bytes], *, tiled: bool, size: int, most: int) -> Part:
    kind = attributes.get("type", b"tiledimage" if tiled else b"scanlineimage")
    if kind not in (b"scanlineimage", b"tiledimage"):
        raise ValueError("it holds deep or unknown pixels; flatten them")
    try:
        display, data = (_window(attributes[name], most) for name in ("displayWindow", "dataWindow"))
        channels = _channels(attributes["channels"])
        compression = attributes["compression"][0]
        chunk = _tile(attributes["tiles"]) if kind == b"tiledimage" else None
    except (KeyError, IndexError, struct.error):
        raise ValueError("its header lacks windows, channels, compression or tiles") from None
    order = attributes.get("lineOrder", b"")
    is_plain = chunk is None and (bytes([compression]), order) == (PLAIN, PLAIN) and display == data
    plain = next(iter(channels.values())) if is_plain and _are_alike(channels) else None
    part = Part(display, data, tuple(sorted(channels)), sum(BYTES[kind] for kind in channels.values()), plain)
    height, width = _shape(data)
    rows, columns = chunk or (min(LINES.get(compression, MOST_LINES), height), width)
    if rows * columns * part.pixel_bytes > MAX_CHUNK_BYTES:
        raise ValueError(f"chunks of {columns}x{rows} pixels of {len(channels)} channels")
    if ceil(height / rows) * ceil(width / columns) * 8 > size:  # the file must hold an offset of 8 bytes per chunk
        raise ValueError("shorter than the table of its chunks")
    return part


def _window(value: bytes, most: int) -> Window:
    x0, y0, x1, y1 = struct.unpack("<4i", value)
    height, width = _shape((x0, y0, x1, y1))
    if min(height, width) < 1 or height * width > most:
        raise ValueError(f"claims {width}x{height} pixels, at most {most} are read")
    if max(map(abs, (x0, y0, x1, y1))) > FARTHEST:
        raise ValueError(f"a window from ({x0}, {y0}) to ({x1}, {y1}), too far off")
    return x0, y0, x1, y1


def _channels(value: bytes) -> dict[str, int]:
    """Return name -> kind of value."""
    found: dict[str, int] = {}
    at = 0
    while value[at] != 0:
        end = value.find(0, at)
        if not 0 < end - at <= LONGEST_NAME or len(found) >= MOST_CHANNELS:
            raise ValueError("its channels are damaged or too many")
        kind, x_sampling, y_sampling = struct.unpack("<i4xii", value[end + 1 : end + 17])
        name = value[at:end].decode("utf-8", "replace")
        if (x_sampling, y_sampling) != (1, 1):
            raise ValueError("its channels are subsampled; export it with full-size channels")
        if kind not in BYTES or name in found:
            raise ValueError("its channels are damaged")
        found[name] = kind
        at = end + 17
    if not found:
        raise ValueError("it has no channels")
    return found


def _are_alike(channels: dict[str, int]) -> bool:
    """Whether all channels have one kind, UINT or FLOAT, and the header lists them in the order of the lines."""
    return list(channels) == sorted(channels) and set(channels.values()) in ({UINT}, {FLOAT})


def _tile(value: bytes) -> tuple[int, int]:
    """Return (height, width)."""
    width, height = struct.unpack("<II", value[:8])
    if not (width and height):
        raise ValueError("tiles without pixels")
    return height, width


def _shape(window: Window) -> tuple[int, int]:
    x0, y0, x1, y1 = window
    return y1 - y0 + 1, x1 - x0 + 1


def _name(file: BinaryIO) -> str:
    text = bytearray()
    while (character := _take(file, 1)) != b"\0":
        text += character
        if len(text) > LONGEST_NAME:
            raise ValueError("its header is damaged")
    return text.decode("utf-8", "replace")


def _take(file: BinaryIO, count: int) -> bytes:
    content = file.read(count)
    if len(content) < count:
        raise ValueError("it ends inside its header")
    return content

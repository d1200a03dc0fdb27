"""Reads PNG and JPEG pictures as stored, checked for completeness and size before decoding; encodes PNG.

OpenCV decodes a truncated PNG or JPEG without an error, with the missing part black or grey. A Gray-code capture would
then decode to wrong coordinates. Therefore this module first walks through the file's structure to its end. It also
refuses files of a hundred bytes that claim a gigabyte of pixels, because neither format compresses that far.
"""

import re
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from counterlight import memory
from counterlight.errors import InputError
from counterlight.files.reading import Source, opened, read_bytes
from counterlight.files.silence import silence

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"


def encode_png(picture: NDArray[Any]) -> bytes:
    """Encode a picture (rows, columns) or (rows, columns, 3) RGB; uint8 or uint16."""
    done, content = cv2.imencode(".png", picture if picture.ndim == 2 else np.ascontiguousarray(picture[..., ::-1]))
    assert done
    return content.tobytes()


def write_png(path: Path, picture: NDArray[Any]) -> None:
    """Encode a picture as `encode_png` does, and write it. Raises OSError if the system refuses."""
    path.write_bytes(encode_png(picture))


SUFFIXES = (".png", ".jpg", ".jpeg")
MAX_SIDE = 16384
MAX_BYTES, EXTRA_BYTES = 1 << 30, 64 << 20  # most bytes of a file; most bytes besides its pixels
PIXEL_BYTES = 8  # most bytes of a pixel: four values of 16 bits
FIX = "copy it from the camera again, or save it as PNG"
JPEG_START = b"\xff\xd8"
PNG_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}  # channels by PNG colour type
MOST_CHUNKS, MOST_SEGMENTS, MOST_SCANS = 1 << 18, 10000, 64  # a decoder processes the whole picture for each scan
DEFLATE_RATIO = 1032  # largest compression ratio of zlib
JPEG_RATIO = 1024  # pixels per byte: each 8x8 block takes at least a bit
EOI, SOS = 0xD9, 0xDA
FRAME_HEADERS = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_MARKER = re.compile(rb"\xff[^\xff\x00\x01\xd0-\xd8]")  # after FF, 0 is a byte of the picture and FF is padding
UPRIGHT = cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH
AS_STORED = UPRIGHT | cv2.IMREAD_IGNORE_ORIENTATION


def read_picture(source: Source, most: int = MAX_SIDE**2, *, upright: bool = False) -> NDArray[Any]:
    """Decode a whole PNG or JPEG: (height, width) or (height, width, 3) RGB, uint8 or uint16, alpha dropped.

    Raises InputError for a missing, truncated or damaged file, another format, or more than 16384 pixels a side.

    source : a path or an open file.
    most : most pixels that are accepted.
    upright : whether to apply an orientation tag. Otherwise the pixels stay as the camera stored them.
    """
    with opened(source, "check the path") as file:
        content = read_bytes(file, min(most * PIXEL_BYTES + EXTRA_BYTES, MAX_BYTES), FIX)
        return decode(content, file.name, most, upright=upright)


def decode(content: bytes, name: str, most: int = MAX_SIDE**2, *, upright: bool = False) -> NDArray[Any]:
    """Decode the content of a file, see `read_picture`. The name is for messages."""
    try:
        measured = _png_size if content.startswith(PNG_SIGNATURE) else _jpeg_size
        height, width = measured(content)
    except (ValueError, struct.error, IndexError) as error:
        raise InputError(f"{name}: {error}; {FIX}") from None
    if not (1 <= height <= MAX_SIDE and 1 <= width <= MAX_SIDE and height * width <= most):
        raise InputError(
            f"{name}: claims {width}x{height} pixels, at most {MAX_SIDE} a side and {most} in all are read"
        )
    memory.check(2 * PIXEL_BYTES * height * width, f"{name}: decoding it", "make it smaller")
    try:
        with silence():
            picture = cv2.imdecode(np.frombuffer(content, np.uint8), UPRIGHT if upright else AS_STORED)
    except cv2.error:
        picture = None
    sizes = {(height, width), (width, height) if upright else (height, width)}
    if picture is None or picture.shape[:2] not in sizes or picture.dtype not in (np.uint8, np.uint16):
        raise InputError(f"{name}: cannot be decoded as an 8- or 16-bit picture; save it as PNG again")
    return picture if picture.ndim == 2 else picture[..., ::-1]


def grey(picture: NDArray[Any]) -> NDArray[Any]:
    """Convert a picture of `read_picture` to grey: (height, width), same type."""
    return picture if picture.ndim == 2 else cv2.cvtColor(np.ascontiguousarray(picture), cv2.COLOR_RGB2GRAY)


def _png_size(content: bytes) -> tuple[int, int]:
    """Return (height, width) of a PNG with all its chunks and correct checksums. Raises ValueError otherwise."""
    whole, at, kind, coded, header = memoryview(content), len(PNG_SIGNATURE), b"", 0, b""
    for _ in range(MOST_CHUNKS):
        if kind == b"IEND":
            break
        if len(whole) - at < 8:
            raise ValueError(f"a PNG that ends after {len(content)} bytes without its end mark (truncated)")
        length, kind = struct.unpack_from(">I4s", whole, at)
        body, checksum = whole[at + 4 : at + 8 + length], whole[at + 8 + length : at + 12 + length]
        if len(checksum) < 4:
            raise ValueError(f"a PNG that ends after {len(content)} bytes, inside a chunk (truncated)")
        if zlib.crc32(body) != int.from_bytes(checksum, "big"):
            raise ValueError(f"a damaged PNG (checksum at byte {at})")
        if (kind == b"IHDR") != (not header):
            raise ValueError("a damaged PNG (it begins with no header, or has two)")
        header = header or bytes(body[4:])
        coded += length if kind == b"IDAT" else 0
        at += 12 + length
    else:
        raise ValueError(f"a PNG of more than {MOST_CHUNKS} chunks")
    width, height, bits, colour = struct.unpack_from(">IIBB", header)
    if height * (width * bits * PNG_CHANNELS.get(colour, 1) // 8) > DEFLATE_RATIO * coded:
        raise ValueError(f"a PNG of {coded} bytes that claims {width}x{height} pixels")
    return height, width


def _jpeg_size(content: bytes) -> tuple[int, int]:
    """Return (height, width) of a JPEG that reaches its end marker (FF D9). Raises ValueError otherwise."""
    if not content.startswith(JPEG_START):
        raise ValueError("neither PNG nor JPEG")
    sizes, scans = [], 0
    for marker, at in _jpeg_markers(content):
        if marker in FRAME_HEADERS:
            sizes.append(struct.unpack_from(">HH", content, at + 3))
        scans += marker == SOS
        if marker == EOI:
            break
    else:
        raise ValueError(f"a JPEG that ends after {len(content)} bytes without its end marker (truncated)")
    if len(sizes) != 1 or scans > MOST_SCANS:
        raise ValueError(f"a damaged JPEG ({len(sizes)} frames of {scans} scans)")
    height, width = sizes[0]
    if height * width > JPEG_RATIO * len(content):
        raise ValueError(f"a JPEG of {len(content)} bytes that claims {width}x{height} pixels")
    return height, width


def _jpeg_markers(content: bytes) -> Iterator[tuple[int, int]]:
    """Yield each marker and the start of its segment. Skips the thumbnails inside segments."""
    at = len(JPEG_START)
    for _ in range(MOST_SEGMENTS):
        found = _MARKER.search(content, at)
        if found is None:
            return
        marker, at = content[found.end() - 1], found.end()
        yield marker, at
        at += int(struct.unpack_from(">H", content, at)[0])

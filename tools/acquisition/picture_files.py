"""Photographs as they were stored: PNG and JPEG, proven whole before they are decoded.

OpenCV decodes a truncated PNG or JPEG without complaint, the missing part black or grey: a Gray-code capture would
decode to wrong coordinates. So the file's own structure is walked to its end first.
"""

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from player.calibration import MAX_SIDE
from player.errors import InputError

SUFFIXES = (".png", ".jpg", ".jpeg")
MAX_BYTES = 1 << 30
PNG_SIGNATURE, JPEG_START = b"\x89PNG\r\n\x1a\n", b"\xff\xd8"
SOI, EOI, SOS, TEM = 0xD8, 0xD9, 0xDA, 0x01
RESTARTS = range(0xD0, 0xD8)
FRAME_HEADERS = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
AS_STORED = cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION


def read_picture(path: Path) -> NDArray[Any]:
    """Decode a whole PNG or JPEG: (height, width) or (height, width, 3) RGB, uint8 or uint16, alpha dropped.

    The pixels stay as the camera stored them: an orientation tag is not applied.
    Raises InputError for a missing, truncated or damaged file, another format, or more than 16384 pixels a side.
    """
    content = _content(path)
    try:
        height, width = _png_size(content) if content.startswith(PNG_SIGNATURE) else _jpeg_size(content)
    except (ValueError, struct.error, IndexError) as error:
        raise InputError(f"{path}: {error}; copy it from the camera again, or save it as PNG") from None
    if not (1 <= height <= MAX_SIDE and 1 <= width <= MAX_SIDE):
        raise InputError(f"{path}: claims {width}x{height} pixels, at most {MAX_SIDE} a side are read")
    try:
        picture = cv2.imdecode(np.frombuffer(content, np.uint8), AS_STORED)
    except cv2.error:
        picture = None
    if picture is None or picture.shape[:2] != (height, width) or picture.dtype not in (np.uint8, np.uint16):
        raise InputError(f"{path}: cannot be decoded as an 8- or 16-bit picture; save it as PNG again")
    return picture if picture.ndim == 2 else picture[..., ::-1]


def _content(path: Path) -> bytes:
    try:
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise InputError(f"{path}: {size >> 20} MiB, at most {MAX_BYTES >> 20} are read")
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}; check the path") from None


def _png_size(content: bytes) -> tuple[int, int]:
    """(height, width) of a PNG whose chunks are all there with their checksums; ValueError otherwise."""
    at, kind, size = len(PNG_SIGNATURE), b"", (0, 0)
    while kind != b"IEND":
        header = content[at : at + 8]
        if len(header) < 8:
            raise ValueError(f"a PNG that ends after {len(content)} bytes without its end mark (truncated)")
        length, kind = struct.unpack(">I4s", header)
        body, checksum = content[at + 4 : at + 8 + length], content[at + 8 + length : at + 12 + length]
        if len(checksum) < 4:
            raise ValueError(f"a PNG that ends after {len(content)} bytes, inside a chunk (truncated)")
        if zlib.crc32(body) != int.from_bytes(checksum, "big"):
            raise ValueError(f"a damaged PNG (checksum at byte {at})")
        if kind == b"IHDR":
            width, height = struct.unpack(">II", body[4:12])
            size = height, width
        at += 12 + length
    return size


def _jpeg_size(content: bytes) -> tuple[int, int]:
    """(height, width) of a JPEG that reaches its end marker (FF D9); ValueError otherwise."""
    if not content.startswith(JPEG_START):
        raise ValueError("neither PNG nor JPEG")
    size = 0, 0
    for marker, at in _jpeg_markers(content):
        if marker in FRAME_HEADERS:
            height, width = struct.unpack(">HH", content[at + 3 : at + 7])
            size = height, width
        elif marker == EOI:
            return size
    raise ValueError(f"a JPEG that ends after {len(content)} bytes without its end marker (truncated)")


def _jpeg_markers(content: bytes) -> Iterator[tuple[int, int]]:
    """Each marker and where its segment starts. Thumbnails lie inside segments and are stepped over."""
    at = 0
    while 0 <= (at := content.find(b"\xff", at)) < len(content) - 1:
        marker, at = content[at + 1], at + 2
        if marker == 0xFF:
            at -= 1  # padding
        elif marker not in (0, TEM, SOI) and marker not in RESTARTS:  # 0: a stuffed byte of the coded picture
            yield marker, at
            if marker != EOI:
                at += int(struct.unpack(">H", content[at : at + 2])[0])

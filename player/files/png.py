"""PNG files, encoded in memory: cv2.imwrite does not notice what the system refuses when a file is closed."""

import struct
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"


def encode_png(picture: NDArray[Any]) -> bytes:
    """A picture (rows, columns) or (rows, columns, 3) of R, G and B; uint8 or uint16."""
    done, content = cv2.imencode(".png", picture if picture.ndim == 2 else np.ascontiguousarray(picture[..., ::-1]))
    assert done
    return content.tobytes()


def encode_stored(picture: NDArray[Any]) -> bytes:
    """As `encode_png`, not compressed: a camera's noise shrinks by a third, and takes five times as long both ways."""
    height, width = picture.shape[:2]
    lines = np.zeros((height, 1 + picture[0].nbytes), np.uint8)  # each begins with its filter, none
    lines[:, 1:] = picture.astype(picture.dtype.newbyteorder(">"), order="C").reshape(height, -1).view(np.uint8)
    colour = 0 if picture.ndim == 2 else 2
    header = struct.pack(">IIBBBBB", width, height, 8 * picture.itemsize, colour, 0, 0, 0)
    chunks = (b"IHDR", header), (b"IDAT", zlib.compress(lines.data, 0)), (b"IEND", b"")
    return PNG_SIGNATURE + b"".join(_chunk(kind, body) for kind, body in chunks)


def _chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(body, zlib.crc32(kind)))


def write_png(path: Path, picture: NDArray[Any]) -> None:
    """Write what `encode_png` makes of a picture; OSError where the system refuses."""
    path.write_bytes(encode_png(picture))

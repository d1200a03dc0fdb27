"""Minimal camera RAW file: an uncompressed colour mosaic in a DNG (Adobe DNG 1.4, on top of TIFF 6)."""

import struct
from collections.abc import Sequence
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

BYTE, ASCII, SHORT, LONG, RATIONAL, SRATIONAL = 1, 2, 3, 4, 5, 10
SIZES = {BYTE: 1, ASCII: 1, SHORT: 2, LONG: 4, RATIONAL: 8, SRATIONAL: 8}
LETTERS = {BYTE: "B", ASCII: "B", SHORT: "H", LONG: "I", RATIONAL: "I", SRATIONAL: "i"}
RGGB = (0, 1, 1, 2)
XTRANS = tuple("RGB".index(letter) for letter in "GBGGRGRGRBGBGBGGRGGRGGBGBGBRGRGRGGBG")


def dng(
    mosaic: NDArray[np.uint16],
    *,
    black: Sequence[int] = (0,),
    white: int = 65535,
    exposure_s: float | None = None,
    pattern: Sequence[int] = RGGB,
    neutral: Sequence[float] = (0.5, 1.0, 0.6),
    area: Sequence[int] = (),
    orientation: int = 1,
) -> bytes:
    """Returns a DNG file of a mosaic, (height, width).

    black : one black level, or four per quad.
    pattern : colours of the quad: 0 red, 1 green, 2 blue.
    neutral : the camera's white balance, which readers of raw sensor values ignore.
    area : top, left, bottom and right of the exposed area.
    orientation : as EXIF numbers it.
    """
    height, width = mosaic.shape
    side = round(len(pattern) ** 0.5)
    repeat = round(len(black) ** 0.5)
    exif = [(33434, RATIONAL, _fraction(exposure_s))] if exposure_s else []
    exposed = [(50829, LONG, list(area))] if area else []
    filters = [(33421, SHORT, [side, side]), (33422, BYTE, list(pattern))] if pattern else []
    tags = [
        (254, LONG, [0]),
        (256, LONG, [width]),
        (257, LONG, [height]),
        (258, SHORT, [16]),
        (259, SHORT, [1]),
        (262, SHORT, [32803 if pattern else 34892]),  # a colour filter array, or linear light
        (271, ASCII, list(b"Counterlight\0")),
        (272, ASCII, list(b"Test\0")),
        (274, SHORT, [orientation]),
        (277, SHORT, [1]),
        (278, LONG, [height]),
        *filters,
        *exif,
        *exposed,
        (50706, BYTE, [1, 4, 0, 0]),
        (50708, ASCII, list(b"Counterlight Test\0")),
        (50713, SHORT, [repeat, repeat]),
        (50714, SHORT, list(black)),
        (50717, LONG, [white]),
        (50721, SRATIONAL, [n for row in np.eye(3, dtype=int) for value in row for n in (int(value), 1)]),
        (50728, RATIONAL, [n for value in neutral for n in _fraction(value)]),
        (50778, SHORT, [21]),
    ]
    pixels = mosaic.astype("<u2").tobytes()
    return _tiff([*tags, (273, LONG, [0]), (279, LONG, [len(pixels)])], pixels)


def mosaic_of(codes: NDArray[np.float64]) -> NDArray[np.uint16]:
    """Mosaic whose RGGB quads hold the pixels of (height, width, 3): (2 height, 2 width)."""
    height, width = codes.shape[:2]
    sites = np.zeros((2 * height, 2 * width), np.uint16)
    for (y, x), colour in zip(np.ndindex(2, 2), RGGB, strict=True):
        sites[y::2, x::2] = codes[..., colour]
    return sites


def _fraction(value: float) -> list[int]:
    exact = Fraction(value).limit_denominator(1_000_000)
    return [exact.numerator, exact.denominator]


def _tiff(tags: Sequence[tuple[int, int, list[int]]], pixels: bytes) -> bytes:
    """Assemble a TIFF: one directory, the values that do not fit into it, and the pixels, located by tag 273."""
    directory = sorted(tags)
    at = 8 + 2 + 12 * len(directory) + 4
    bodies = {tag: struct.pack(f"<{len(values)}{LETTERS[kind]}", *values) for tag, kind, values in directory}
    start = at + sum(len(body) + len(body) % 2 for body in bodies.values() if len(body) > 4)
    bodies[273] = struct.pack("<I", start)
    entries, outside = b"", b""
    for tag, kind, _ in directory:
        body = bodies[tag]
        count = len(body) // SIZES[kind]
        value = body.ljust(4, b"\0") if len(body) <= 4 else struct.pack("<I", at + len(outside))
        entries += struct.pack("<HHI", tag, kind, count) + value
        outside += (body + b"\0" * (len(body) % 2)) if len(body) > 4 else b""
    return b"II*\0" + struct.pack("<IH", 8, len(directory)) + entries + bytes(4) + outside + pixels

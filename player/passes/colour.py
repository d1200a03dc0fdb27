"""Converts a frame's colour metadata to the numbers of both backends: code matrices, primaries, chroma positions."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from counterlight.media.frames import PixelFormat

# Kr, Kb of ITU-R BT.601, BT.709 and BT.2020 (non-constant luminance).
LUMA_WEIGHTS = {"bt601": (0.299, 0.114), "bt709": (0.2126, 0.0722), "bt2020": (0.2627, 0.0593)}
LUMINANCE = (0.2126, 0.7152, 0.0722)  # weights of linear RGB, ITU-R BT.709
LUMINANCE_2020 = (0.2627, 0.6780, 0.0593)
# CIE xy of red, green and blue: ITU-R BT.709 and BT.2020, SMPTE EG 432-1. White is D65 in all three.
PRIMARIES = {
    "bt709": ((0.64, 0.33), (0.30, 0.60), (0.15, 0.06)),
    "bt2020": ((0.708, 0.292), (0.170, 0.797), (0.131, 0.046)),
    "p3": ((0.680, 0.320), (0.265, 0.690), (0.150, 0.060)),
}
D65 = 0.3127, 0.3290
# Chroma coordinate of luma pixel 0 if two luma pixels share a chroma sample: on the sample, or a quarter before it.
SITED, BETWEEN = 0.0, -0.25


@dataclass(frozen=True)
class Decoding:
    """RGB code values = to_rgb · (samples − black) / span; chroma sample = luma pixel / subsampling + chroma_offset.

    black, span : (3,). In code values of the planes.
    to_rgb : (3, 3).
    subsampling : (x, y). Luma pixels per chroma sample.
    chroma_offset : (x, y).
    """

    black: NDArray[np.float64]
    span: NDArray[np.float64]
    to_rgb: NDArray[np.float64]
    subsampling: tuple[int, int]
    chroma_offset: tuple[float, float]


def decoding_of(pixels: PixelFormat) -> Decoding:
    """Return the decoding of a pixel format (ITU-R BT.601, BT.709, BT.2020; BT.2100 for the ranges at 8 to 16 bit)."""
    luma, chroma = pixels.planes[0], pixels.planes[1]
    ratio = round(luma.width / chroma.width), round(luma.height / chroma.height)
    x = SITED if pixels.chroma_siting in ("left", "topleft") else BETWEEN
    y = SITED if pixels.chroma_siting == "topleft" else BETWEEN
    offset = x if ratio[0] == 2 else 0.0, y if ratio[1] == 2 else 0.0
    top = float((1 << pixels.depth) - 1)
    if pixels.layout != "yuv":
        return Decoding(np.zeros(3), np.full(3, top), np.eye(3), (1, 1), (0.0, 0.0))
    unit = float(1 << (pixels.depth - 8))
    middle = 128 * unit
    if pixels.full_range:
        black, span = [0.0, middle, middle], [top, top, top]
    else:
        black, span = [16 * unit, middle, middle], [219 * unit, 224 * unit, 224 * unit]
    return Decoding(np.array(black), np.array(span), _to_rgb(pixels.matrix), ratio, offset)


def to_screen(primaries: str) -> NDArray[np.float64]:
    """Return the (3, 3) matrix from linear RGB of `primaries` to the screen's BT.709; the identity for BT.709."""
    if primaries == "bt709":
        return np.eye(3)
    return np.asarray(np.linalg.solve(_to_xyz(PRIMARIES["bt709"]), _to_xyz(PRIMARIES[primaries])), np.float64)


def _to_xyz(primaries: tuple[tuple[float, float], ...]) -> NDArray[np.float64]:
    """Return the normalised primary matrix, whose white has Y = 1 (SMPTE RP 177)."""
    columns, white = (np.array([(x / y, 1, (1 - x - y) / y) for x, y in points]).T for points in (primaries, [D65]))
    return np.asarray(columns * np.linalg.solve(columns, white[:, 0]))


def _to_rgb(matrix: str) -> NDArray[np.float64]:
    kr, kb = LUMA_WEIGHTS[matrix]
    kg = 1 - kr - kb
    cr, cb = 2 * (1 - kr), 2 * (1 - kb)
    return np.array([[1, 0, cr], [1, -cb * kb / kg, -cr * kr / kg], [1, cb, 0]])

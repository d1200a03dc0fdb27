"""Find out how a camera processes its pictures, from captures of black-and-white patterns.

JPEG leaves few high frequencies in blocks of 8x8 pixels on its grid, and more in blocks off the grid. Colour at half
resolution is interpolated, so that each second change from pixel to pixel is the mean of its neighbours. Sharpening
makes edges brighter than white. Noise reduction leaves noise that neighbours share.
"""

from collections.abc import Sequence

import numpy as np
from scipy.fft import dctn

from counterlight.arrays import FloatArray

LUMA = np.array([0.299, 0.587, 0.114])  # ITU-R BT.601
# BLOCK: pixels per side of a JPEG block; HIGH: sum of the two indices from which a frequency is high
BLOCK, HIGH = 8, 10
# a frequency below GONE code values (of 255) is gone; MORE_GONE: share gone on the block grid minus share off the grid
GONE, MORE_GONE = 1.0, 0.3
# squared deviation from the neighbours' mean, on the colour grid relative to off the grid; at least 0.66 for 4:4:4
HALVED = 0.6
OVERSHOOT = 0.04  # least overshoot of an edge, as a share of the range
OVERSHOT, JPEG_OVERSHOT = 0.005, 0.16  # share of the pixels that edges cross; JPEG of quality 75 has up to 0.13
EDGE = 0.2  # least change of the pattern that counts as an edge, as a share of the range
SHARED = 0.4  # correlation of the noise of neighbours, from which on noise counts as shared
STEPS = 0.5  # in code values; smaller noise is rounding


def traces(white: Sequence[FloatArray], patterns: Sequence[FloatArray], *, eight_bits: bool) -> str:
    """Returns what the files show, in words.

    white : one or two captures of white, code values from 0 to 1, (height, width, 3); noise needs two.
    patterns : captures of patterns, likewise.
    """
    jpeg = eight_bits and _is_jpeg(patterns)
    said = ["8-bit JPEG" if jpeg else "8 bits" if eight_bits else "more than 8 bits"]
    if jpeg and _has_halved_colour(patterns):
        said.append("colour at half resolution")
    if _is_sharpened(white[0], patterns, JPEG_OVERSHOT if jpeg else OVERSHOT):
        said.append("sharpened (switch it off, it falsifies the curve)")
    if not jpeg and len(white) > 1 and _is_smoothed(white, 1 / 255 if eight_bits else 0.0):
        said.append("noise reduced")
    return ", ".join(said)


def _is_jpeg(patterns: Sequence[FloatArray]) -> bool:
    on, off = (np.mean([_gone(each @ LUMA, start) for each in patterns]) for start in (0, BLOCK // 2))
    return bool(on - off > MORE_GONE)


def _gone(luma: FloatArray, start: int) -> float:
    """Returns the share of high frequencies that are zero, in blocks that begin at `start`."""
    height, width = (BLOCK * ((size - start) // BLOCK) for size in luma.shape)
    cut = 255 * luma[start : start + height, start : start + width]
    blocks = cut.reshape(height // BLOCK, BLOCK, width // BLOCK, BLOCK).transpose(0, 2, 1, 3)
    high = np.add.outer(np.arange(BLOCK), np.arange(BLOCK)) >= HIGH
    values = np.abs(dctn(blocks, axes=(2, 3), norm="ortho"))[..., high]
    return float(np.mean(values < GONE)) if values.size else 0.0


def _has_halved_colour(patterns: Sequence[FloatArray]) -> bool:
    off = np.zeros(2)  # sums over the pixels off the grid and on the grid
    for pattern in patterns:
        for channel in (0, 2):
            change = np.diff(pattern[..., channel] - pattern @ LUMA, axis=1)
            apart = change[:, 1:-1] - (change[:, :-2] + change[:, 2:]) / 2
            off += [np.sum(apart[:, phase::2] ** 2) for phase in (0, 1)]
    return bool(off[1] < HALVED * off[0])


def _is_sharpened(white: FloatArray, patterns: Sequence[FloatArray], most: float) -> bool:
    edges = over = 0
    for pattern in patterns:
        crossed = np.abs(np.diff(pattern, axis=1, append=pattern[:, -1:])) > EDGE
        edges += int(crossed.sum())
        over += int(np.sum(pattern > white + OVERSHOOT))
    return over > most * edges > 0


def _is_smoothed(white: Sequence[FloatArray], step: float) -> bool:
    noise = white[1] - white[0]
    left, right = noise[:, :-1], noise[:, 1:]
    variance = float(np.mean(noise**2))
    return variance > (STEPS * step) ** 2 and float(np.mean(left * right)) > SHARED * variance

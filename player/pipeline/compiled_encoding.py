"""The compiled pass from light to code values; see encoding.py."""

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from counterlight.pipeline.compiled import PICTURE, PLANE, Picture, Whole, inlined, kernel, looked_up, within

NO_DITHER, ORDERED, NOISE = range(3)


@kernel(
    f"{PICTURE}, {PICTURE}, int32[:, ::1], int64, {PICTURE}, boolean, float32[:, :, :, ::1], float32, int64, uint32, "
    f"{PLANE}, uint8[:, :, ::1]"
)
def encode(
    light: Picture,
    codes: Picture,
    of_column: Whole,
    row_height: Any,
    colours: Picture,
    mixes: Any,
    segments: Picture,
    scale: Any,
    dither: Any,
    frame: Any,
    thresholds: Picture,
    out: NDArray[np.uint8],
) -> None:
    """Convert linear light to 8-bit code values (encode).

    codes : (projectors, 3, samples). Code values over √light.
    of_column : (rows of projectors, width). Index of the projector that each column belongs to.
    colours : (projectors, 3, 3). Used if `mixes` is true.
    segments : (projectors, 2, 3, samples), or empty.
    thresholds : of ORDERED dither, repeated.
    """
    for y in numba.prange(out.shape[0]):
        for x in range(out.shape[1]):
            seed, own = np.uint32(0), of_column[y // row_height, x]
            if dither == NOISE:
                seed = _scrambled(np.uint32(x) + _scrambled(np.uint32(y) + _scrambled(frame)))
            red, green, blue = light[y, x, 0], light[y, x, 1], light[y, x, 2]
            if mixes:
                red, green, blue = (
                    colours[own, 0, 0] * red + colours[own, 0, 1] * green + colours[own, 0, 2] * blue,
                    colours[own, 1, 0] * red + colours[own, 1, 1] * green + colours[own, 1, 2] * blue,
                    colours[own, 2, 0] * red + colours[own, 2, 1] * green + colours[own, 2, 2] * blue,
                )
            roots = _root(red, scale), _root(green, scale), _root(blue, scale)
            if segments.shape[0] > 0:
                roots = _without_segment(roots, segments[own])
            threshold = np.float32(0.5)
            if dither == ORDERED:
                threshold = thresholds[y % thresholds.shape[0], x % thresholds.shape[1]]
            for i in range(3):
                if dither == NOISE:
                    hashed = _scrambled(seed + np.uint32(i)) >> np.uint32(9)
                    threshold = np.float32((np.float64(hashed) + 0.5) / 8388608.0)
                value = looked_up(codes[own, i], roots[i]) * np.float32(255) + threshold
                out[y, x, i] = np.uint8(min(value, np.float32(255)))


@inlined
def _root(light: Any, scale: Any) -> Any:
    return np.sqrt(within(light / scale, np.float32(0), np.float32(1)))


@inlined
def _without_segment(roots: Any, tables: Any) -> Any:
    """Return √(p − s(m)) of the three primaries, given √p."""
    each = looked_up(tables[0, 0], roots[0]), looked_up(tables[0, 1], roots[1]), looked_up(tables[0, 2], roots[2])
    darkest = np.sqrt(min(each[0], min(each[1], each[2])))
    return (
        np.sqrt(max(roots[0] * roots[0] - looked_up(tables[1, 0], darkest), np.float32(0))),
        np.sqrt(max(roots[1] * roots[1] - looked_up(tables[1, 1], darkest), np.float32(0))),
        np.sqrt(max(roots[2] * roots[2] - looked_up(tables[1, 2], darkest), np.float32(0))),
    )


@inlined
def _scrambled(v: Any) -> Any:
    v = np.uint32(v * np.uint32(747796405) + np.uint32(2891336453))
    v = np.uint32(((v >> ((v >> np.uint32(28)) + np.uint32(4))) ^ v) * np.uint32(277803737))
    return np.uint32((v >> np.uint32(22)) ^ v)

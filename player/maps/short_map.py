"""Row maps with weights of 16 bits, and what the rounding changes at most."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from counterlight.maps.row_map import FloatArray, RowMap, in_blocks

LARGEST_HALF = float(np.finfo(np.float16).max)  # as a float16, quotients and logarithms with it would be rounded, too
SMALLEST_HALF = float(np.finfo(np.float16).smallest_normal)  # a GPU may take smaller ones for 0


def half_scale(packed: RowMap) -> np.float32:
    """The largest power of two that keeps the weights, multiplied by it, within the range of halves."""
    weights = packed.entries[..., :3]
    largest = max(float(weights.max()), -float(weights.min()), 1e-30)
    return np.float32(2.0 ** np.floor(np.log2(LARGEST_HALF / largest)))


def to_half(weights: FloatArray, scale: np.float32) -> NDArray[np.float16]:
    """scale · weights as halves; what would be denormal is 0."""
    halves = (weights * scale).astype(np.float16)
    halves[np.abs(halves) < SMALLEST_HALF] = 0
    return halves


def in_half(packed: RowMap, brightest: NDArray[np.floating]) -> tuple[RowMap, float]:
    """The map with weights of 16 bits, scaled by a power of two into their range, and the certified change of a drive.

    δ_i = Σ_j |T⁺_ij − half(T⁺_ij)| u_j is the largest change of a desired light within u.
    brightest : u, (source pixels, 3).
    """
    scale, entries = half_scale(packed), packed.entries.copy()
    entries[..., :3] = to_half(entries[..., :3], scale).astype(np.float32) / scale
    return replace(packed, entries=entries), _change(packed, scale, brightest)


def _change(packed: RowMap, scale: np.float32, brightest: NDArray[np.floating]) -> float:
    """The largest δ_i of `in_half`, found block by block."""
    largest = 0.0
    for _, rows in in_blocks(packed):
        lost = np.abs(to_half(rows.weights, scale).astype(np.float32) / scale - rows.weights)
        if lost.size:
            sums = replace(rows, weights=lost * brightest[rows.indices]).sums()
            largest = max(largest, float(sums.max()))
    return largest

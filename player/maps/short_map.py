"""Row maps with weights of 16 bits, and what the rounding changes at most."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from counterlight.maps.row_map import FloatArray, RowMap, unpack

LARGEST_HALF = float(np.finfo(np.float16).max)  # as a float16, quotients and logarithms with it would be rounded, too
SMALLEST_HALF = float(np.finfo(np.float16).smallest_normal)  # a GPU may take smaller ones for 0


def half_scale(packed: RowMap) -> np.float32:
    """The largest power of two that keeps the weights, multiplied by it, within the range of halves."""
    largest = max(float(np.abs(packed.entries[..., :3]).max()), 1e-30)
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
    weights, scale = packed.entries[..., :3], half_scale(packed)
    entries = packed.entries.copy()
    entries[..., :3] = to_half(weights, scale).astype(np.float32) / scale
    lost = replace(packed, entries=np.concatenate([np.abs(entries[..., :3] - weights), entries[..., 3:]], -1))
    return replace(packed, entries=entries), max(_row_sums(lost, brightest), default=0.0)


def _row_sums(packed: RowMap, brightest: NDArray[np.floating]) -> Iterator[float]:
    """The largest Σ_j |w_ij| u_j of each channel."""
    rows = unpack(packed)
    if rows.indices.size:
        owner = np.repeat(np.arange(rows.lengths.size), rows.lengths)
        for i in range(3):
            yield float(np.bincount(owner, rows.weights[:, i] * brightest[rows.indices, i]).max())

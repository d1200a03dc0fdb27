"""Similarity of neighbouring projector pixels for the camera: the cosine between their footprints in T,

    κ_jk = Σ w T_ij T_ik / √(Σ w T_ij² · Σ w T_ik²).

κ is 0 if no camera pixel sees both, and nearly 1 far out of focus, where light may move between them unnoticed.
"""

from collections.abc import Iterator

import numpy as np

from counterlight.arrays import FloatArray, IntArray
from counterlight.tools.transport.transport import Csr, Transport, channel, luminance_matrix

MOST_ENTRIES = 1 << 26  # entries to process; larger T are sampled by camera pixels: each projector pixel has hundreds
AT_ONCE = 1 << 21


def overlap(T: Transport, weights: FloatArray, projector: tuple[int, int]) -> tuple[FloatArray, FloatArray]:
    """Return κ of each pixel with its right and lower neighbour, (projector height, projector width); 0 at the border.

    T : transport; far light is ignored.
    weights : w, (camera pixels,).
    """
    width, count = projector[1], T.shape[1]
    sums = [np.zeros(count) for _ in range(3)]
    lengths = lengths_of(T)
    for rows in batches(_drawn(lengths, weights), lengths):
        light = _written_out(T.at(rows), np.sqrt(weights[rows]))
        for each, offset in zip(sums, (0, 1, width), strict=True):
            each += _shared(light, offset)
    right, down = (_cosines(each, sums[0], offset) for each, offset in ((sums[1], 1), (sums[2], width)))
    right.reshape(projector)[:, -1] = 0
    return right.reshape(projector), down.reshape(projector)


def lengths_of(T: Transport) -> FloatArray:
    """Return the entries of each camera pixel, with blurred light written out, (camera pixels,)."""
    lengths = T.near.lengths.astype(np.float64)
    if T.blurred is not None:
        scatter = T.blurred.scatter
        lengths += np.bincount(scatter.rows, T.blurred.gather.lengths[scatter.indices], scatter.shape[0])
    return lengths


def batches(rows: IntArray, lengths: FloatArray) -> Iterator[IntArray]:
    """Yield batches of camera pixels with about AT_ONCE entries. lengths : of all pixels."""
    ends = np.cumsum(lengths[rows])
    yield from np.split(rows, np.searchsorted(ends, np.arange(AT_ONCE, ends[-1] if ends.size else 0, AT_ONCE)))


def _drawn(lengths: FloatArray, weights: FloatArray) -> IntArray:
    """Return camera pixels with weight: all, or a random sample with MOST_ENTRIES entries."""
    rows = np.flatnonzero((weights > 0) & (lengths > 0))
    share = MOST_ENTRIES / max(lengths[rows].sum(), 1)
    if share < 1:
        rows = np.sort(np.random.default_rng(0).choice(rows, int(share * rows.size), replace=False))
    return rows


def _written_out(T: Transport, factors: FloatArray) -> Csr:
    """Return the luminance of T with cells written out as pixels, every row multiplied by its factor."""
    light = luminance_matrix(T.near)
    if T.blurred is not None:
        light = Csr(light + luminance_matrix(T.blurred.scatter) @ channel(T.blurred.gather, 0))
    data = light.data.astype(np.float64) * np.repeat(factors, np.diff(light.indptr))
    return Csr((data, light.indices, light.indptr), shape=light.shape)


def _shared(light: Csr, offset: int) -> FloatArray:
    """Return Σ_i A_ij A_i,j+offset, (columns,)."""
    shape = light.shape[0], light.shape[1] + offset
    here, neighbour = (Csr((light.data, light.indices + by, light.indptr), shape=shape) for by in (offset, 0))
    both = Csr(here.multiply(neighbour))
    return np.bincount(both.indices, both.data, shape[1])[offset:].astype(np.float64)


def _cosines(shared: FloatArray, squares: FloatArray, offset: int) -> FloatArray:
    neighbour = np.concatenate([squares[offset:], np.zeros(offset)])
    root = np.sqrt(squares * neighbour)
    return np.asarray(np.minimum(np.divide(shared, root, out=np.zeros_like(root), where=root > 0), 1))

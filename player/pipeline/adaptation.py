"""CPU functions, in numpy, of the passes that adapt a picture to the room (content.py states the goal)."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from counterlight.pipeline.content import OFFSETS, SCALES, tile_grid

FloatArray = NDArray[np.floating]
SumsOf = Callable[..., FloatArray]


@dataclass(frozen=True)
class Limits:
    """The light that a room allows each camera pixel; see content.py for the symbols.

    near_white : (camera height, camera width, 3). 1 − F 1.
    near_ambient : (camera height, camera width, 3). e − F e.
    ambient : (camera height, camera width, 3). e.
    most : (camera height, camera width, 4). S·1; the fourth channel is 0 for pixels that do not count.
    """

    near_white: FloatArray
    near_ambient: FloatArray
    ambient: FloatArray
    most: FloatArray


def clip_sums(
    u: FloatArray, near: FloatArray, limits: Limits, white: float, budget: float, offset: float | None
) -> FloatArray:
    """Return how much more light clips than the budget allows, for 16 candidates (clip_sums.frag, then block_sum.frag).

    u : (camera height, camera width, 3). The target in shares of white.
    near : (camera height, camera width, 3). u − F u.
    budget : share of A that may clip.
    offset : o, for which all scales are tried. None tries the offsets with s = 1 − o, and counts only light below 0.

    Returns (16,), summed over the samples.
    """
    at = np.ix_(*samples(u.shape[:2]))
    ambient, most = limits.ambient[at], limits.most[at]
    offsets, shares = tried(offset)
    allowed = budget * np.maximum(white * u[at], ambient)
    sums = np.empty(16)
    for i, (o, share) in enumerate(zip(offsets, shares, strict=True)):
        needed = white * ((1 - o) * share * near[at] + o * limits.near_white[at]) - limits.near_ambient[at]
        clipped = np.maximum(-needed, 0)
        if offset is not None:
            clipped = clipped + np.maximum(needed - most[..., :3], 0)
        sums[i] = np.sum((clipped - allowed) * most[..., 3:])
    return sums


def tried(offset: float | None) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return o and s / (1 − o) of the 16 candidates, (16,) each."""
    return (OFFSETS, np.ones(16)) if offset is None else (np.full(16, offset), SCALES)


def samples(shape: tuple[int, int]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the rows and columns of a picture (height, width) that enter the sums."""
    return tuple(map(_along, shape, *tile_grid(shape)))  # type: ignore[return-value]


def _along(length: int, tile: int, step: int) -> NDArray[np.int64]:
    starts = range(0, length, tile)
    return np.concatenate([np.arange(start, min(start + tile, length), step) for start in starts])


def choose(candidates: FloatArray, sums: FloatArray, otherwise: int) -> float:
    """Return the first candidate whose sum is at most 0, interpolated towards its predecessor (choose.frag).

    otherwise : index of the candidate to return if no sum is at most 0.
    """
    within = np.flatnonzero(sums <= 0)
    if not within.size:
        return float(candidates[otherwise])
    i = within[0]
    if i == 0:
        return float(candidates[0])
    share = sums[i - 1] / (sums[i - 1] - sums[i])
    return float(candidates[i - 1] + share * (candidates[i] - candidates[i - 1]))


def tone_of(
    u: FloatArray, near: FloatArray, limits: Limits, white: float, budget: float, sums_of: SumsOf | None = None
) -> NDArray[np.float64]:
    """Return (s, o) for one picture. `sums_of` replaces clip_sums."""
    sums_of = sums_of or clip_sums
    sums = sums_of(u, near, limits, white, budget / 2, None)
    offset = choose(OFFSETS, sums, len(OFFSETS) - 1)
    sums = sums_of(u, near, limits, white, budget, offset)
    return np.array([(1 - offset) * choose(SCALES, sums, int(np.argmin(sums))), offset])

"""The adaptation of a frame to the room, in numpy: the formula of the passes in counterlight.passes.adaptation."""

import numpy as np
from numpy.typing import NDArray

from counterlight.passes.adaptation import OFFSETS, SCALES, Limits, choose, samples, tried

FloatArray = NDArray[np.floating]


def clip_sums(
    u: FloatArray, near: FloatArray, limits: Limits, white: float, budget: float, offset: float | None
) -> FloatArray:
    """Return how much more light is clipped than the budget allows, for 16 candidates.

    u : (camera height, camera width, 3). The target in shares of white.
    near : (camera height, camera width, 3). u − F u.
    budget : share of A that may be clipped.
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


def tone_of(u: FloatArray, near: FloatArray, limits: Limits, white: float, budget: float) -> NDArray[np.float64]:
    """Return the scale s and the offset o that adapt one picture to the room."""
    sums = clip_sums(u, near, limits, white, budget / 2, None)
    offset = choose(OFFSETS, sums, len(OFFSETS) - 1)
    sums = clip_sums(u, near, limits, white, budget, offset)
    return np.array([(1 - offset) * choose(SCALES, sums, int(np.argmin(sums))), offset])

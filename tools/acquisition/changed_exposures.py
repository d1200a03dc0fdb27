"""Separate changes of a projector's light from changes of a camera's exposure: g_kr = p_k q_r.

g_kr is the gain of projector k in camera r. The factors are known only up to a common number. One camera is assumed to
keep its exposure: the camera for which the fewest changes remain.
"""

import numpy as np

from counterlight.arrays import FloatArray

CHANGED = 0.01  # share of light; smaller differences are no change
ROUNDS = 64  # rounds of alternating medians; each halves the remaining difference


def changed_exposures(gains: FloatArray) -> FloatArray:
    """Returns q of each camera, (cameras, 3), 1 where it has not changed.

    gains : (projectors, cameras, 3). g; NaN where the camera does not see that projector alone.
    """
    logs = np.log(gains)
    count = gains.shape[1]
    found = [_factors(logs, held) for held in range(count)]
    exposures = min((q for q, _ in found), key=lambda q: _changes(logs, q))
    factors = np.exp(exposures)
    unchanged = np.abs(factors - 1).max(axis=1) <= CHANGED
    return np.where(unchanged[:, None], 1.0, factors)


def _factors(logs: FloatArray, held: int) -> tuple[FloatArray, FloatArray]:
    """Returns log q (cameras, 3) and log p (projectors, 3), by medians, with q of camera `held` fixed at 1."""
    q = np.zeros(logs.shape[1:])
    for _ in range(ROUNDS):
        p = _median(logs - q, 1)
        q = _median(logs - p[:, None], 0)
        q -= q[held]
    return q, p


def _changes(logs: FloatArray, q: FloatArray) -> int:
    """Returns the number of cameras and projectors that have changed."""
    both = np.concatenate([q, _median(logs - q, 1)])
    return int(np.count_nonzero(np.abs(np.expm1(both)).max(axis=1) > CHANGED))


def _median(values: FloatArray, axis: int) -> FloatArray:
    """Returns the median of the finite values; 0 where there are none."""
    known = np.isfinite(values)
    filled = np.where(known.any(axis=axis, keepdims=True), values, 0.0)
    return np.asarray(np.nanmedian(filled, axis=axis))

"""Whose light has changed, a projector's or a camera's: g_kr = p_k q_r of what camera r sees of projector k.

Both factors are known up to one number only. The cameras' exposures are taken to be what they were as far as that
explains most: of all cameras that one is held whose exposure, unchanged, leaves the fewest changes.
"""

import numpy as np

from counterlight.arrays import FloatArray

CHANGED = 0.01  # of light: less is no change
ROUNDS = 64  # of medians by turns; what is left of a difference halves with each


def changed_exposures(gains: FloatArray) -> FloatArray:
    """q of each camera, (cameras, 3), 1 where it has not changed.

    gains : (projectors, cameras, 3), g; NaN where the camera does not see that projector alone.
    """
    logs = np.log(gains)
    count = gains.shape[1]
    found = [_factors(logs, held) for held in range(count)]
    exposures = min((q for q, _ in found), key=lambda q: _changes(logs, q))
    factors = np.exp(exposures)
    unchanged = np.abs(factors - 1).max(axis=1) <= CHANGED
    return np.where(unchanged[:, None], 1.0, factors)


def _factors(logs: FloatArray, held: int) -> tuple[FloatArray, FloatArray]:
    """log q (cameras, 3) and log p (projectors, 3), by medians, q of one camera held at 1."""
    q = np.zeros(logs.shape[1:])
    for _ in range(ROUNDS):
        p = _median(logs - q, 1)
        q = _median(logs - p[:, None], 0)
        q -= q[held]
    return q, p


def _changes(logs: FloatArray, q: FloatArray) -> int:
    """How many cameras and projectors have changed."""
    both = np.concatenate([q, _median(logs - q, 1)])
    return int(np.count_nonzero(np.abs(np.expm1(both)).max(axis=1) > CHANGED))


def _median(values: FloatArray, axis: int) -> FloatArray:
    """Of what is known; 0 where nothing is."""
    known = np.isfinite(values)
    filled = np.where(known.any(axis=axis, keepdims=True), values, 0.0)
    return np.asarray(np.nanmedian(filled, axis=axis))

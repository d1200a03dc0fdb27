"""M₀, the mixing of a neutral surface: how the camera's channels would see the primaries on white paper."""

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray, IntArray
from counterlight.maps.mixing import invertible
from counterlight.pipeline.content import BRIGHT_PERCENTILE

DARK = 0.05  # share of the bright pixels; a channel darker than this is mostly noise
NEAR = 0.3  # distance in tint within which pixels have most weight
# a percentile of the pixels' tint, and the largest value there if the camera is balanced on white
BALANCED_PERCENTILE, BALANCED = 5.0, 0.25
BRIGHTEST_PERCENTILE = 90.0
MOST_COUNTED = 1 << 19  # camera pixels that are used at most; more would not improve the result
SLOPE_NOISE = 0.03  # smallest difference of tint that carries information about the mixing


def counted_pixels(mask: NDArray[np.bool_]) -> IntArray:
    """Return the pixels that count, or an even sample of them if they are many."""
    counted = np.flatnonzero(mask)
    return np.asarray(counted[:: max(1, -(-counted.size // MOST_COUNTED))])


def neutral_mixing(primaries: NDArray[np.floating], mask: NDArray[np.bool_]) -> FloatArray:
    """Return M₀, (3, 3), camera channel by primary. Its rows sum to 1, so that a white picture is the camera's white.

    The camera's view of one primary, N_kl = F_kl / Σ_m F_ml, hardly depends on the paint that reflects it. The small
    dependence is modelled by regression on the tint, (log W_r/W_g, log W_b/W_g) of the white floodlight W_k = Σ_l F_kl,
    with near pixels weighted more. N is evaluated at tint 0, which is white for targets. Displays scale their primaries
    to their white point, so M₀ = N diag(N⁻¹ 1). If no paint comes near tint 0 (a camera that is not balanced), the tint
    of the brightest pixels counts as neutral, because paint removes light.

    primaries : (3, camera height, camera width, 3). Light above ambient.
    mask : camera pixels that count.

    Returns NaN if nothing is lit in every channel, or if primaries look alike.
    """
    F = np.moveaxis(np.asarray(primaries).reshape(3, -1, 3)[:, counted_pixels(mask)].astype(np.float64), 0, -1)
    white, columns = F.sum(axis=2), F.sum(axis=1)
    bright = np.percentile(white, BRIGHT_PERCENTILE, axis=0) if len(white) else np.zeros(3)
    lit = (bright > 0).all() & (white > DARK * bright).all(axis=1) & (columns > 0).all(axis=1)
    unknown = np.full((3, 3), np.nan)
    if not lit.any():
        return unknown
    white, primary = white[lit], F[lit] / columns[lit][:, None, :]
    tint, brightness = np.log(white[:, [0, 2]] / white[:, [1, 1]]), (white / bright).min(axis=1)
    N = _at(_neutral_tint(tint, brightness), tint, primary, brightness)
    if not invertible(N):
        return unknown
    shares = np.linalg.solve(N, np.ones(3))
    return np.asarray(N * shares) if (shares > 0).all() else unknown


def _neutral_tint(tint: FloatArray, brightness: FloatArray) -> FloatArray:
    """Return the neutral tint, (2,): 0 if any paint comes near, otherwise the tint of the brightest tenth."""
    if np.percentile(np.linalg.norm(tint, axis=1), BALANCED_PERCENTILE) <= BALANCED:
        return np.zeros(2)
    brightest = brightness >= np.percentile(brightness, BRIGHTEST_PERCENTILE)
    return np.asarray(np.median(tint[brightest], axis=0))


def _at(neutral: FloatArray, tint: FloatArray, primary: FloatArray, brightness: FloatArray) -> FloatArray:
    """Regress N, (n, 3, 3), on the tint, (n, 2), and evaluate it at the neutral tint."""
    away = np.sum((tint - neutral) ** 2, axis=1)
    weight = brightness * np.exp(-(away - away.min()) / (2 * NEAR**2))
    weight /= weight.sum()
    centre, mean = weight @ tint, np.einsum("n,nkl->kl", weight, primary)
    offset = tint - centre
    spread = np.einsum("n,ni,nj->ij", weight, offset, offset) + SLOPE_NOISE**2 * np.eye(2)
    together = np.einsum("n,ni,nkl->ikl", weight, offset, primary)
    slopes = np.linalg.solve(spread, together.reshape(2, 9)).reshape(2, 3, 3)
    return np.asarray(mean + np.einsum("i,ikl->kl", neutral - centre, slopes))

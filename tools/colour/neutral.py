"""M₀, the mixing of a neutral surface: what the camera's channels would see of the primaries on white paper."""

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray, IntArray
from counterlight.maps.mixing import invertible
from counterlight.pipeline.content import BRIGHT_PERCENTILE

DARK = 0.05  # darker in some channel, as a share of the bright pixels, is mostly noise
NEAR = 0.3  # tint; nearer pixels decide
BALANCED_PERCENTILE, BALANCED = 5.0, 0.25  # tint of the most neutral pixels of a camera that is balanced on white
BRIGHTEST_PERCENTILE = 90.0
MOST_ASKED = 1 << 19  # camera pixels that tell it as well as more of them
SLOPE_NOISE = 0.03  # tints that differ by less say nothing of how the mixing goes with them


def asked_pixels(mask: NDArray[np.bool_]) -> IntArray:
    """Those that count, or evenly some of them where they are many."""
    counted = np.flatnonzero(mask)
    return np.asarray(counted[:: max(1, -(-counted.size // MOST_ASKED))])


def neutral_mixing(primaries: NDArray[np.floating], mask: NDArray[np.bool_]) -> FloatArray:
    """(3, 3), camera channel by primary, rows of sum 1, so that a white picture is the camera's white.

    What a camera sees of one primary, N_kl = F_kl / Σ_m F_ml, hardly depends on the paint that reflects it. What does
    is regressed on its tint, (log W_r/W_g, log W_b/W_g) of the white floodlight W_k = Σ_l F_kl, near pixels first,
    and N taken where the tint is 0: that is white for targets. As displays' primaries are scaled to their white point,
    M₀ = N diag(N⁻¹ 1). Where no paint comes near a tint of 0 (a camera that is not balanced), that of the brightest
    pixels stands for neutral: paint takes light away.

    primaries : (3, camera height, camera width, 3), light above ambient.  mask : the camera pixels that count.
    Returns NaN where nothing is lit in every channel, or primaries look alike.
    """
    F = np.moveaxis(np.asarray(primaries).reshape(3, -1, 3)[:, asked_pixels(mask)].astype(np.float64), 0, -1)
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
    """(2,): 0 if any paint comes near, else that of the tenth that is brightest in its weakest channel."""
    if np.percentile(np.linalg.norm(tint, axis=1), BALANCED_PERCENTILE) <= BALANCED:
        return np.zeros(2)
    brightest = brightness >= np.percentile(brightness, BRIGHTEST_PERCENTILE)
    return np.asarray(np.median(tint[brightest], axis=0))


def _at(neutral: FloatArray, tint: FloatArray, primary: FloatArray, brightness: FloatArray) -> FloatArray:
    """Regress N, (n, 3, 3), on the tint, (n, 2), and take it where that is neutral."""
    away = np.sum((tint - neutral) ** 2, axis=1)
    weight = brightness * np.exp(-(away - away.min()) / (2 * NEAR**2))
    weight /= weight.sum()
    centre, mean = weight @ tint, np.einsum("n,nkl->kl", weight, primary)
    offset = tint - centre
    spread = np.einsum("n,ni,nj->ij", weight, offset, offset) + SLOPE_NOISE**2 * np.eye(2)
    together = np.einsum("n,ni,nkl->ikl", weight, offset, primary)
    slopes = np.linalg.solve(spread, together.reshape(2, 9)).reshape(2, 3, 3)
    return np.asarray(mean + np.einsum("i,ikl->kl", neutral - centre, slopes))

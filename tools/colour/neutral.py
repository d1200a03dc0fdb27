"""M₀, the mixing of a neutral surface: what the camera's channels would see of the primaries on white paper."""

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray

BRIGHT_PERCENTILE = 99.0
NEUTRAL_PERCENTILE = 90.0


def neutral_mixing(primaries: NDArray[np.floating], mask: NDArray[np.bool_]) -> FloatArray:
    """(3, 3), camera channel by primary, rows of sum 1: the median over the tenth that is brightest in every channel.

    Paint takes light away, most of it in some channel, so what is brightest in its weakest channel is the most neutral
    that the room has. Channels are compared each with its own brightest (99th percentile), so that the camera's gains
    do not matter. With the rows' sums 1 a white picture is the camera's white.

    primaries : (3, camera height, camera width, 3), light above ambient.  mask : the camera pixels that count.
    Returns NaN where hardly anything is lit in every channel.
    """
    F = np.moveaxis(np.asarray(primaries, np.float64)[:, mask], 0, -1)
    white = F.sum(axis=-1)
    bright = np.percentile(white, BRIGHT_PERCENTILE, axis=0) if len(white) else np.zeros(3)
    if not (bright > 0).all():
        return np.full((3, 3), np.nan)
    weakest = (white / bright).min(axis=1)
    least = np.percentile(weakest, NEUTRAL_PERCENTILE)
    if not least > 0:
        return np.full((3, 3), np.nan)
    chosen = weakest >= least
    shares = np.median(F[chosen] / white[chosen][..., None], axis=0)
    return np.asarray(shares / shares.sum(axis=1, keepdims=True))

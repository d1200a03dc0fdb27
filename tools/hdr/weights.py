"""The weight of a code value: least at both ends of the camera's range, and 0 where it clips."""

from collections.abc import Callable

import numpy as np

from counterlight.arrays import FloatArray

STEEPNESS = 4.0  # W of thesis eq. 3.7; Robertson et al. (2003) and OpenCV use the same


def hat(codes: FloatArray) -> FloatArray:
    """Returns w(z) = min(z, 1 − z), scaled to a peak of 1 (thesis eq. 3.5; Debevec and Malik 1997, eq. 4).

    codes : 0 to 1 of the camera's range.
    """
    return np.asarray(1 - np.abs(2 * codes - 1))


def gaussian(codes: FloatArray) -> FloatArray:
    """Returns w(z) = exp(−W (2z − 1)²), shifted and scaled to 0 at both ends and 1 in the middle (thesis eq. 3.7).

    codes : 0 to 1 of the camera's range.
    """
    least = np.exp(-STEEPNESS)
    bell = np.exp(-STEEPNESS * (2 * codes - 1) ** 2)
    return np.asarray(np.maximum(bell - least, 0) / (1 - least))


WEIGHTINGS: dict[str, Callable[[FloatArray], FloatArray]] = {"hat": hat, "gaussian": gaussian}


def weight_table(weighting: str, levels: int) -> FloatArray:
    """Returns the weight of each code value of a camera with `levels` levels, (levels,)."""
    return WEIGHTINGS[weighting](np.linspace(0, 1, levels))

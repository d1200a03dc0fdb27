"""Framing, brightness and focus of a camera's live picture, for aiming it."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import BoolArray, FloatArray
from counterlight.tools.acquisition.cameras.camera import Shot

BRIGHTEST = 99.9  # percentile; ignores a few hot pixels and highlights
SAMPLED = 1 << 20  # values in the sample for a percentile
MIDDLE = 512  # side of the square in which focus is judged, in camera pixels
# LIT: share of the brightest rise; NOISES: multiple of the noise. A pixel above both counts as lit.
LIT, NOISES = 0.1, 4
SPECK = 5  # side of the median filter, in pixels
LEAST_LIT = 0.001  # least share of the camera's pixels that must be lit
# share of the fullest row or column of lit pixels; emptier ones hold only reflections next to the picture
EDGE_SHARE = 0.1
# least margin as a share of the view's sides, least filled share of its area (docs/first-rig.md)
LEAST_MARGIN, LEAST_FILLED = 0.02, 0.3


@dataclass(frozen=True)
class Framing:
    """The position of the projector's picture in the camera's view.

    left, above, right, below : dark margins as shares of the view's width and height.
    filled : share of the view that is lit.
    """

    left: float
    above: float
    right: float
    below: float
    filled: float

    def __str__(self) -> str:
        sides = {"left": self.left, "right": self.right, "upper": self.above, "lower": self.below}
        cut = [name for name, margin in sides.items() if margin < LEAST_MARGIN]
        if cut:
            edges = " and ".join(filter(None, (", ".join(cut[:-1]), cut[-1])))
            return f"the picture reaches the {edges} edge of the view: turn the camera, zoom out"
        if self.filled < LEAST_FILLED:
            return f"the picture fills {100 * self.filled:.0f} % of the view: zoom in"
        return (
            f"the picture is inside the view, margins of {100 * min(sides.values()):.0f} % and more; it fills "
            f"{100 * self.filled:.0f} %"
        )


def framing(black: FloatArray, again: FloatArray, white: FloatArray) -> Framing | None:
    """Returns the framing from two black pictures and a white one, (height, width, 3); None if it is not visible."""
    rise = (white - black).sum(axis=2)
    noise = float(np.std((again - black).sum(axis=2)))
    rises = rise > max(LIT * float(np.percentile(rise, BRIGHTEST)), NOISES * noise, float(np.finfo(np.float32).tiny))
    lit = cv2.medianBlur(rises.astype(np.uint8), SPECK) > 0
    if lit.mean() < LEAST_LIT:
        return None
    (left, right), (above, below) = _ends(lit.sum(axis=0)), _ends(lit.sum(axis=1))
    return Framing(left, above, right, below, float(lit.mean()))


def _ends(counts: NDArray[np.integer]) -> tuple[float, float]:
    """Returns the shares of the axis before the first and after the last full row or column."""
    full = np.flatnonzero(counts >= EDGE_SHARE * counts.max())
    return float(full[0] / counts.size), float(1 - (full[-1] + 1) / counts.size)


def brightest(shot: Shot) -> float:
    """Returns the brightest value of a shot (99.9th percentile) as a share of the camera's range."""
    step = max(1, int(np.sqrt(shot.size / SAMPLED)))
    return float(np.percentile(shot[::step, ::step], BRIGHTEST)) / float(np.iinfo(shot.dtype).max)


def sharpness(light: FloatArray) -> float:
    """Returns the mean squared gradient over the mean squared light in the middle of (height, width, 3).

    Higher is sharper. The value depends on the picture but not on its brightness, so only compare it while focusing.
    """
    height, width = light.shape[:2]
    top, left = max(0, (height - MIDDLE) // 2), max(0, (width - MIDDLE) // 2)
    middle = light[top : top + MIDDLE, left : left + MIDDLE].mean(axis=2)
    steep = sum(float(np.mean(np.diff(middle, axis=axis) ** 2)) for axis in (0, 1))
    return steep / max(float(np.mean(middle**2)), float(np.finfo(np.float64).tiny))


def shown(
    light: FloatArray, clipped: BoolArray, shape: tuple[int, int], mark: tuple[int, int, int]
) -> NDArray[np.uint8]:
    """Returns the view at the size of a window, (height, width, 3) code values, with clipped pixels in colour `mark`.

    light : (camera height, camera width, 3). 1 is the top of the range.
    clipped : (camera height, camera width) bool. A window pixel is marked if any camera pixel in it clips.
    """
    size = shape[1], shape[0]
    how = cv2.INTER_AREA if shape[0] < light.shape[0] else cv2.INTER_NEAREST
    small = cv2.resize(light.astype(np.float32), size, interpolation=how)
    codes = np.rint(255 * small.clip(0, 1) ** (1 / 2.2)).astype(np.uint8)
    codes[cv2.resize(clipped.astype(np.float32), size, interpolation=how) > 0] = mark
    return codes

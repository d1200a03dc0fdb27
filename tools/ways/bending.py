"""Light that did not come straight: camera pixels that see a projector's picture where no opaque surface could show it.

A camera and a projector see each surface point on matching lines, for surfaces of any shape (epipolar geometry:
xᵀ F x' = 0 for a camera pixel x' and a projector pixel x). Glass and mirrors bend light off these lines. F is fitted to
the middles of the footprints (Longuet-Higgins 1981; O'Toole et al. 2014 for light that leaves the lines).

The fit takes F of least median distance over samples of eight pixels. Least squares over the nearest pairs then refine
it (Rousseeuw 1984, Hartley 1997). A flat wall does not determine F, and every F that fits it is suitable.
"""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from counterlight.arrays import BoolArray, FloatArray

FEWEST = 64  # middles that distinguish the lines from chance
MOST = 4000  # middles that are used
SAMPLES, OF_EIGHT, REFINED, NEAR = 400, 8, 5, 4.0  # NEAR: multiple of the median distance that the refinement includes
WINDOW = 3  # camera pixels per side: single middles are as coarse as the projector's pixels
LEAST_PX, USUAL = 0.2, 5.0  # off the lines: projector pixels, and multiples of the usual distance in this room


class Lines:
    """The line in a projector's picture of each camera pixel's straight light; no lines if too few pixels are lit."""

    def __init__(self, middle: FloatArray, lit: BoolArray) -> None:
        """Fit the lines.

        middle : (camera height, camera width, 2), y and x.
        lit : (camera height, camera width). Where `middle` is valid.
        """
        self._lit = lit
        self._lines: FloatArray | None = None
        y, x = np.nonzero(lit)
        if y.size < FEWEST:
            return
        some = slice(None, None, -(-y.size // MOST))
        seen, lighting = np.stack([x, y], axis=1)[some] + 0.5, middle[lit][some, ::-1]
        F = _fundamental(seen, np.asarray(lighting, np.float64))
        self._lines = np.asarray(_with_ones(_centres(lit.shape)) @ F.T)

    def distance(self, place: FloatArray) -> FloatArray:
        """Returns signed distances of places from their pixels' lines, projector pixels; 0 if there are no lines.

        place : (camera height, camera width, 2), y and x in the projector's picture.
        """
        if self._lines is None:
            return np.zeros(self._lit.shape)
        return _off(self._lines, place.reshape(-1, 2)[:, ::-1]).reshape(self._lit.shape)

    def bent(self, middle: FloatArray) -> BoolArray:
        """Returns where middles, averaged over neighbours, are further off their lines than usual."""
        off = np.abs(smoothed(self.distance(middle), self._lit))
        usual = float(np.median(off[self._lit])) if self._lit.any() else 0.0
        return self._lit & (off > max(LEAST_PX, USUAL * usual))


def smoothed(values: FloatArray, known: BoolArray) -> FloatArray:
    """Returns means of the known values in windows, (height, width)."""
    count = ndimage.uniform_filter(known.astype(np.float64), WINDOW, mode="constant")
    total = ndimage.uniform_filter(np.where(known, values, 0.0), WINDOW, mode="constant")
    return np.asarray(np.divide(total, count, out=np.zeros_like(total), where=known & (count > 0)))


def _fundamental(seen: NDArray[np.floating], lighting: FloatArray) -> FloatArray:
    """Returns F, (3, 3), of the lines F x' on which most pairs lie.

    seen, lighting : x' and x, (pairs, 2), x before y.
    """
    A, B = _conditioned(seen), _conditioned(lighting)
    equations = (_with_ones(lighting) @ B.T)[:, :, None] * (_with_ones(seen) @ A.T)[:, None, :]
    equations = equations.reshape(-1, 9)
    drawn = np.random.default_rng(0).integers(len(seen), size=(SAMPLES, OF_EIGHT))
    tried = np.linalg.svd(equations[drawn])[2][:, -1]
    found = [B.T @ each.reshape(3, 3) @ A for each in tried]
    medians = [np.median(np.abs(_off(_with_ones(seen) @ F.T, lighting))) for F in found]
    best = found[int(np.argmin(medians))]
    for _ in range(REFINED):
        off = np.abs(_off(_with_ones(seen) @ best.T, lighting))
        near = off <= NEAR * np.median(off)
        best = B.T @ np.linalg.svd(equations[near], full_matrices=False)[2][-1].reshape(3, 3) @ A
    return np.asarray(best)


def _conditioned(points: NDArray[np.floating]) -> FloatArray:
    """Returns the similarity (3, 3) that moves points to mean 0 and to lengths of about √2."""
    middle = points.mean(axis=0)
    size = np.sqrt(2) / max(float(np.sqrt(((points - middle) ** 2).sum(axis=1).mean())), 1e-9)
    return np.array([[size, 0, -size * middle[0]], [0, size, -size * middle[1]], [0, 0, 1]])


def _off(lines: FloatArray, points: FloatArray) -> FloatArray:
    """Returns signed distances (n,) of points from lines.

    lines : (n, 3).
    points : (n, 2), x before y.
    """
    length = np.hypot(lines[:, 0], lines[:, 1])
    off = (lines * _with_ones(points)).sum(axis=1)
    return np.asarray(np.divide(off, length, out=np.zeros_like(off), where=length > 0))


def _centres(shape: tuple[int, ...]) -> FloatArray:
    y, x = np.mgrid[: shape[0], : shape[1]].reshape(2, -1) + 0.5
    return np.stack([x, y], axis=1)


def _with_ones(points: NDArray[np.floating]) -> FloatArray:
    return np.concatenate([points, np.ones((len(points), 1))], axis=1)

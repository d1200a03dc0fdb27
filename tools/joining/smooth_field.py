"""A smooth field through scattered, noisy values of a picture's pixels, continued where there are no values.

The field is a trend plus local corrections. The trend covers the whole picture: a projective map if it explains the
values, else an affine one. Local affine fits under a Gaussian correct it from coarse to fine; each level fits the
residual of the coarser levels. Far from any values, a fit fades into the coarser one, so that the field continues
smoothly. Values that contradict their neighbours (reflections, wrong matches) are left out.
"""

from collections.abc import Callable

import numpy as np
from scipy import ndimage

from counterlight.arrays import BoolArray, FloatArray, IntArray

REWEIGHTED = 10  # iterations until outliers no longer affect the trend
# a value counts little if it is further from the trend than USUAL times the median distance and than LEAST
USUAL, LEAST = 4.0, 0.05
CONTRADICTED = 0.5  # limit like USUAL and LEAST, for the distance of a value from the median of its neighbours
BESIDE = np.mgrid[-2:3, -2:3].reshape(2, -1).T  # offsets of the neighbours
ALONE = 8  # fewest values in a neighbourhood, including the middle value, which is ignored if there are fewer
AT_ONCE = 1 << 15  # pixels whose neighbours are processed at a time
WORTH = 0.5  # the projective trend must leave less than this share of the affine trend's distances
STEEPEST = 2.0  # largest ratio of scales over the picture
COARSEST = 4  # cells along the longer side
WIDTH = 2.0  # standard deviation of the Gaussian, in cells
CONSTANT_RIDGE, SLOPE_RIDGE = 1e-3, 0.05  # ridges of a fit's constant and slopes, relative to a full neighbourhood
MOST_POINTS = 20000  # largest number of points for fitting a trend


def smooth_field(values: FloatArray, known: BoolArray, finest: float) -> FloatArray:
    """Return the field at every pixel from values (height, width, 2).

    known : (height, width) bool. Values that count; at least one.
    finest : pixels over which the values are noisy (a step of a staircase).
    """
    field, cell = _trend(values, known), max(known.shape) / COARSEST
    known = known & _uncontradicted(np.where(known[..., None], values - field, 0), known, max(1, round(finest / 2)))
    while True:
        left = np.where(known[..., None], values - field, 0)
        field = field + _local(left, known.astype(np.float64), max(1, round(cell)))
        if cell <= max(finest / WIDTH, 1):
            return field
        cell /= 2


def _uncontradicted(left: FloatArray, known: BoolArray, step: int) -> BoolArray:
    """Return where enough neighbours, `step` pixels apart, have similar values. left : residual of the trend."""
    reach = int(2 * step)
    wide = np.pad(
        np.where(known[..., None], left, np.nan), ((reach, reach), (reach, reach), (0, 0)), constant_values=np.nan
    )
    rows, columns = np.nonzero(known)
    off, count = np.empty(rows.size), np.empty(rows.size, np.int64)
    for start in range(0, rows.size, AT_ONCE):
        some = slice(start, start + AT_ONCE)
        at = np.stack([rows[some], columns[some]], axis=1)[:, None] + reach + step * BESIDE
        there = wide[at[..., 0], at[..., 1]]
        count[some] = np.isfinite(there[..., 0]).sum(axis=1)
        off[some] = _lengths(left[rows[some], columns[some]] - np.nanmedian(there, axis=1))
    agreed = (off <= max(USUAL * float(np.median(off)), CONTRADICTED)) & (count >= ALONE)
    kept = np.zeros_like(known)
    kept[rows, columns] = agreed if agreed.any() else True
    return kept


def _trend(values: FloatArray, known: BoolArray) -> FloatArray:
    """Return the projective or affine map of pixel positions that fits most of the values best, at every pixel."""
    at = np.flatnonzero(known)
    at = at[:: -(-at.size // MOST_POINTS)]
    x, y = _positions(known)
    size = max(known.shape)
    basis = np.stack([np.ones_like(x), (x - x.flat[at].mean()) / size, (y - y.flat[at].mean()) / size], axis=-1)
    targets = values.reshape(-1, 2)[at]
    affine, projective = (_steadily(each, basis, at, targets) for each in (_affine, _projective))
    assert affine is not None
    if projective is None:
        return affine
    bent, flat = (float(np.median(_lengths(trend.reshape(-1, 2)[at] - targets))) for trend in (projective, affine))
    return projective if bent < WORTH * flat else affine


def _steadily(
    fit: Callable[[FloatArray, FloatArray, FloatArray, FloatArray], FloatArray | None],
    basis: FloatArray,
    at: IntArray,
    targets: FloatArray,
) -> FloatArray | None:
    """Return a robust fit, in which distant values count little."""
    heavy = np.ones((at.size, 1))
    for _ in range(REWEIGHTED):
        found = fit(basis, basis.reshape(-1, 3)[at], targets, heavy)
        if found is None:
            return None
        away = _lengths(found.reshape(-1, 2)[at] - targets)
        heavy = 1 / (1 + (away / max(USUAL / 2 * float(np.median(away)), LEAST)) ** 2)[:, None]
    return found


def _affine(basis: FloatArray, some: FloatArray, targets: FloatArray, heavy: FloatArray) -> FloatArray:
    return np.asarray(basis @ np.linalg.lstsq(some * heavy, targets * heavy)[0])


def _projective(basis: FloatArray, some: FloatArray, targets: FloatArray, heavy: FloatArray) -> FloatArray | None:
    """Return the projective fit, or None if it is steeper than a camera's view of a wall."""
    origin, zeros = targets.mean(axis=0), np.zeros_like(some)
    u, v = (targets - origin).T[..., None]
    equations = np.concatenate(
        [
            heavy * np.concatenate([some, zeros, -u * some[:, 1:]], axis=1),
            heavy * np.concatenate([zeros, some, -v * some[:, 1:]], axis=1),
        ]
    )
    h = np.linalg.lstsq(equations, np.concatenate([heavy * u, heavy * v])[:, 0])[0]
    depth = 1 + basis[..., 1:] @ h[6:]
    if depth.min() <= 0 or depth.max() > STEEPEST * depth.min():
        return None
    return np.asarray(np.stack([basis @ h[:3], basis @ h[3:6]], axis=-1) / depth[..., None] + origin)


def _local(left: FloatArray, weights: FloatArray, cell: int) -> FloatArray:
    """Return affine fits under a Gaussian of WIDTH cells, evaluated at the cells' centres and interpolated."""
    x, y = (each / cell for each in _positions(weights))
    shape = (int(y.max()) + 1, int(x.max()) + 1)
    index = (y.astype(np.int64) * shape[1] + x.astype(np.int64)).ravel()

    def blurred(values: FloatArray) -> FloatArray:
        sums = np.bincount(index, (weights * values).ravel(), shape[0] * shape[1]) / cell**2
        return np.asarray(ndimage.gaussian_filter(sums.reshape(shape), WIDTH, mode="constant").ravel())

    basis = np.ones_like(x), x, y
    moments = np.stack([np.stack([blurred(a * b) for a in basis], axis=-1) for b in basis], axis=-1)
    targets = np.stack([np.stack([blurred(a * left[..., i]) for a in basis], axis=-1) for i in range(2)], axis=-1)
    # Convert from cells to units of the Gaussian's width around each cell's centre, in which the ridges are defined.
    about = np.broadcast_to(np.diag([1, 1 / WIDTH, 1 / WIDTH]), moments.shape).copy()
    middles = np.mgrid[: shape[0], : shape[1]].reshape(2, -1) + 0.5
    about[:, 1, 0], about[:, 2, 0] = -middles[1] / WIDTH, -middles[0] / WIDTH
    moments = about @ moments @ about.transpose(0, 2, 1) + np.diag([CONSTANT_RIDGE, SLOPE_RIDGE, SLOPE_RIDGE])
    fits = np.linalg.solve(moments, about @ targets)[:, 0].reshape(*shape, 2)
    if cell == 1:
        return np.asarray(fits)
    places = np.stack([y - 0.5, x - 0.5])
    return np.stack([ndimage.map_coordinates(fits[..., i], places, mode="nearest") for i in range(2)], axis=-1)


def _positions(picture: FloatArray | BoolArray) -> tuple[FloatArray, FloatArray]:
    """Return x and y of every pixel's centre, (height, width)."""
    y, x = np.mgrid[: picture.shape[0], : picture.shape[1]] + 0.5
    return x, y


def _lengths(offsets: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(offsets, axis=-1))

"""Fit what a camera sees of a projector picture, to pairs.

c_k(y) = g_k (e_k(y) + s_k(y) Σ_d h_kd(y) v_k(y + d) + Σ_l m_kl(y) v_l(y) + Σ_j q_kj(y) (G_j s_k v_k)(y))

v is the picture's light, φ(code), at the places that the camera sees. h is the spread over a window, m mixes the other
primaries in, and the blurs G_j are the halo. Every coefficient is fitted three times by regularised least squares: per
large cell of the camera picture, per small cell, and per pixel, each level to what the previous level left over.
With few pairs, there is little evidence about single pixels, so they keep the values of their cells.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray
from counterlight.command import track
from counterlight.tools.pairs.geometry import Pictures, regression

REACH = 2  # pixels from the middle of the window of h to its edge
BLOCK = 12  # camera pixels per side of the blocks that wide blurs refer to
HALO = 4.0, 12.0, 36.0, 96.0  # standard deviations of the blurs G_j in camera pixels
CELLS = 48, 12, 1  # camera pixels per side of each level's cells
SCALE, OFFSET = (0.3, 0.1, 0.1), (0.1, 0.005, 0.005)  # standard deviation per level: of s, and of e in radiance
WINDOW = [(dy, dx) for dy in range(2 * REACH + 1) for dx in range(2 * REACH + 1) if (dy, dx) != (REACH, REACH)]
BAND = 24  # rows of camera pixels at a time
NEAR = 8, 8, 2  # squared distance of the farthest taps of a level
TAPS, FLOOR = (0.2, 0.04, 0.02), (0.05, 0.004, 0.001)  # standard deviations of taps of h: nearest, farthest
MIXED, BENT, HALOS = (0.1, 0.05, 0.05), (0.1, 0.05, 0.05), (0.1, 0.02, 0.0)
SATURATED = 0.98  # share of the camera's range from which on a value is saturated
SPREAD, WIDE_HALO = 5, 5 + len(WINDOW) + 1  # first features of h, and of the blurs G_j after the first
AROUND = 3.0  # standard deviation in camera pixels of the neighbourhood from which little varied pixels take s
LITTLE, LEAST_VARIED = 0.01, 1e-5  # variances of little varied pixels, and outside the picture; shares of the median
BINS = 24  # levels of light at which the residual's variance is measured


@dataclass(frozen=True)
class Level:
    """Coefficients of one level: (3, cells down, cells across, features)."""

    cell: int
    coefficients: NDArray[np.floating]

    @classmethod
    def empty(cls, cell: int, shape: tuple[int, int]) -> "Level":
        down, across = (-(-side // cell) for side in shape)
        return cls(cell, np.zeros((3, down, across, len(prior(0))), np.float32))

    def plane(self, k: int, feature: int, shape: tuple[int, int]) -> NDArray[np.floating]:
        """Return a coefficient at every camera pixel, (height, width)."""
        grid = np.ascontiguousarray(self.coefficients[k, ..., feature])
        if self.cell == 1:
            return grid
        return between_cells(grid, self.cell, shape)

    def light(self, F: NDArray[np.floating], k: int) -> NDArray[np.floating]:
        """Return the light of channel k, (pairs, height, width), of features F."""
        result = np.zeros(F.shape[1:], np.float32)
        for number, feature in enumerate(F):
            if self.coefficients[k, ..., number].any():
                result += feature * self.plane(k, number, F.shape[2:])
        return result


@dataclass(frozen=True)
class Model:
    """A fitted model.

    slope, offset : (height, width, 3). s and e.
    levels : corrections, from coarse to fine.
    """

    slope: NDArray[np.floating]
    offset: NDArray[np.floating]
    levels: tuple[Level, ...]

    def predict(self, shown: Pictures, levels: int | None = None) -> Pictures:
        """Predict the captures of pictures from their warped light, both (pairs, height, width, 3)."""
        result = self.slope * shown + self.offset
        for k in range(3):
            F = features(shown, halos_of(shown[..., k], self.slope[..., k]), self.slope, k)
            for level in self.levels[:levels]:
                result[..., k] += level.light(F, k)
        return result

    def halo(self, shown: Pictures) -> Pictures:
        """Return the halo in the captures of pictures."""
        result = np.zeros_like(shown)
        for k in range(3):
            blurs = halos_of(shown[..., k], self.slope[..., k])
            for number, blur in enumerate(blurs, WIDE_HALO - 1):
                for level in self.levels:
                    result[..., k] += blur * level.plane(k, number, shown.shape[1:3])
        return result


def bands(height: int, rows: int) -> Iterator[slice]:
    for start in range(0, height, rows):
        yield slice(start, min(start + rows, height))


def halos_of(shown: NDArray[np.floating], slope: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return the blurs of one channel's reflected light: (blurs, pairs, height, width)."""
    light = shown * slope
    blocks = np.stack([block_means(picture) for picture in light])
    height, width = slope.shape
    down, across = blocks.shape[1:]
    near = [cv2.GaussianBlur(picture, (0, 0), HALO[0], borderType=cv2.BORDER_CONSTANT) for picture in light]
    result = [np.stack(near)]
    for sigma in HALO[1:]:
        blurred = block_blur(down, sigma) @ blocks @ block_blur(across, sigma)
        result.append(
            np.stack([between_cells(each.astype(np.float32), BLOCK, (height, width)) for each in list(blurred)])
        )
    return np.stack(result)


def block_means(picture: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return the means of BLOCK × BLOCK camera pixels; darkness lies outside the picture."""
    height, width = picture.shape
    padded = np.pad(picture, ((0, -height % BLOCK), (0, -width % BLOCK)))
    return np.asarray(padded.reshape(-(-height // BLOCK), BLOCK, -1, BLOCK).mean(axis=(1, 3)))


def block_blur(count: int, sigma: float) -> FloatArray:
    """Return the matrix of a Gaussian blur over `count` blocks along one axis."""
    distance = (np.arange(count)[:, None] - np.arange(count)) * BLOCK / sigma
    return np.asarray(np.exp(-(distance**2) / 2) * BLOCK / (sigma * np.sqrt(2 * np.pi)))


def between_cells(grid: NDArray[np.floating], cell: int, shape: tuple[int, int]) -> NDArray[np.floating]:
    """Interpolate values of cells at every camera pixel of a (height, width) picture."""
    x, y = _in_cells(cell, shape)
    return np.asarray(cv2.remap(grid, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))


@lru_cache(maxsize=4)
def _in_cells(cell: int, shape: tuple[int, int]) -> list[NDArray[np.float32]]:
    """Return x and y of every camera pixel, in cells from the middle of the first."""
    y, x = (((np.arange(side) + 0.5) / cell - 0.5).astype(np.float32) for side in shape)
    return list(np.meshgrid(x, y))


def prior(level: int, linear: bool = False) -> NDArray[np.floating]:
    """Return the standard deviation of each feature's coefficient; 0 for features that a level does not change."""
    distance = np.array([(dy - REACH) ** 2 + (dx - REACH) ** 2 for dy, dx in WINDOW])
    taps = np.where(distance <= NEAR[level], TAPS[level] * np.exp(-distance / 2.0) + FLOOR[level], 0)
    own = [OFFSET[level], SCALE[level], *([0, 0, 0] if linear else [BENT[level], MIXED[level], MIXED[level]])]
    return np.array([*own, *taps, 0 if linear else HALOS[level], *[HALOS[level]] * (len(HALO) - 1)], np.float32)


def features(shown: Pictures, halos: NDArray[np.floating], slope: NDArray[np.floating], k: int) -> NDArray[np.floating]:
    """Return the features of channel k in radiance, (features, pairs, height, width)."""
    height, width = shown.shape[1:3]
    v = shown[..., k]
    padded = np.pad(v, ((0, 0), (REACH, REACH), (REACH, REACH)), mode="edge")
    result = np.empty((len(prior(0)), *v.shape), np.float32)
    near: list[NDArray[np.floating]] = [v, v * v, shown[..., (k + 1) % 3], shown[..., (k + 2) % 3]]
    for dy, dx in WINDOW:
        near.append(padded[:, dy : dy + height, dx : dx + width] - v)
    result[0] = 1
    for number, each in enumerate(near, 1):
        np.multiply(each, slope[..., k], out=result[number])
    result[1 + len(near) :] = halos
    return result


def fit(
    shown: Pictures,
    captures: Pictures,
    *,
    gains: FloatArray | None = None,
    cells: Sequence[int] = CELLS,
    linear: bool = False,
) -> Model:
    """Fit the model.

    shown : the pictures' light as the camera sees it without spread, (pairs, height, width, 3).
    captures : (pairs, height, width, 3).
    gains : (pairs, 3). Gain of each capture; None for 1.
    linear : whether each channel depends linearly on its own primary only.
    """
    valid = (captures < SATURATED).astype(np.float32)
    if gains is not None:
        captures = np.asarray(captures / gains[:, None, None], np.float32)
    slope, offset = _affine(shown, captures)
    rest = captures - (slope * shown + offset)
    height, width = slope.shape[:2]
    levels = [Level.empty(cell, (height, width)) for cell in cells]
    for k in track(range(3), f"fit of {len(shown)} pairs, channels", 3):
        F = features(shown, halos_of(shown[..., k], slope[..., k]), slope, k)
        for number, level in enumerate(levels):
            used, std = np.flatnonzero(prior(number, linear)), prior(number, linear)
            variance = _variance(captures[..., k], rest[..., k])
            w = valid[..., k] / np.sqrt(_at(variance, captures[..., k] - rest[..., k]))
            for rows in bands(height, max(BAND, level.cell)):
                A = F[:, :, rows][used] * std[used, None, None, None] * w[:, rows]
                cells_of = slice(rows.start // level.cell, -(-rows.stop // level.cell))
                level.coefficients[k, cells_of][..., used] = (
                    _solved(A, rest[:, rows, :, k] * w[:, rows], level.cell) * std[used]
                )
            rest[..., k] -= level.light(F, k)
    return Model(slope, offset, tuple(levels))


def _affine(shown: Pictures, captures: Pictures) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Return s ≥ 0 and e of each camera pixel, (height, width, 3); little varied pixels take s from their neighbours.

    A pixel whose pictures hardly vary would divide noise by noise: a slope of 16 in a room of slopes up to 1.
    """
    slope, _, _ = regression(shown, captures)
    varied = shown.var(axis=0)
    usual = float(np.median(varied[varied > 0])) if varied.any() else 1.0
    light = cv2.GaussianBlur(varied * slope, (0, 0), AROUND)
    around = light / np.maximum(cv2.GaussianBlur(varied, (0, 0), AROUND), 1e-9)
    around[varied < LEAST_VARIED * usual] = 0  # outside the picture
    slope = np.maximum((varied * slope + LITTLE * usual * around) / (varied + LITTLE * usual), 0)
    return slope.astype(np.float32), (captures.mean(axis=0) - slope * shown.mean(axis=0)).astype(np.float32)


def _solved(A: NDArray[np.floating], y: NDArray[np.floating], cell: int) -> NDArray[np.floating]:
    """Return the ridge solution of every cell, (cells down, cells across, features).

    A : (features, pairs, rows, width).
    y : (pairs, rows, width).
    """
    count, _, height, width = A.shape
    down, across = -(-height // cell), -(-width // cell)
    if cell == 1:
        each = np.ascontiguousarray(A.transpose(2, 3, 0, 1))
        J, h = each @ each.swapaxes(2, 3), each @ y.transpose(1, 2, 0)[..., None]
    else:
        J = np.zeros((down, across, count, count), np.float32)
        h = np.zeros((down, across, count, 1), np.float32)
        for i in range(down):
            for j in range(across):
                here = (..., slice(i * cell, (i + 1) * cell), slice(j * cell, (j + 1) * cell))
                part, rest = A[here].reshape(count, -1), y[here].reshape(-1, 1)
                J[i, j], h[i, j] = part @ part.T, part @ rest
    J = J / cell + np.eye(count, dtype=np.float32)  # neighbouring pixels' errors are alike
    return np.asarray(np.linalg.solve(J, h / cell))[..., 0]


def _variance(light: NDArray[np.floating], rest: NDArray[np.floating]) -> FloatArray:
    """Measure the variance of residuals by the level of light: (2, BINS)."""
    light, square = (light - rest).ravel()[::7], rest.ravel()[::7] ** 2
    edges = np.quantile(light, np.linspace(0, 1, BINS + 1))
    number = np.clip(np.searchsorted(edges, light) - 1, 0, BINS - 1)
    count = np.maximum(np.bincount(number, minlength=BINS), 1)
    means = [np.bincount(number, each, BINS) / count for each in (light, square)]
    return np.stack([means[0], np.maximum(means[1], 1e-8)])


def _at(variance: FloatArray, light: NDArray[np.floating]) -> NDArray[np.floating]:
    return np.asarray(np.interp(light, variance[0], variance[1]), np.float32)

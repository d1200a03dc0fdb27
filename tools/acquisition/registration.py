"""Measure how far a projector's picture has moved since the calibration, from one smooth random picture.

A camera that has not moved sees c = g T W p + e of a picture p that lands elsewhere in the raster. (W p)(u) = p(M u),
where M is a homography from the calibrated raster to the projector's own pixels. The whole-pixel shift is the peak of
the correlation of p with Tᵀ c. Gauss-Newton steps refine it, with (W p)' = ∇p(M u) · M' u, weights that fall with the
residual (Cauchy), and the gain fitted alongside. The number of unknowns grows from a shift to the homography as far as
the data support it. The picture is a sum of smooth octaves, so that nothing repeats and a step works from far away.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage
from scipy.sparse.linalg import LinearOperator, aslinearoperator

from counterlight.arrays import BoolArray, FloatArray, IntArray
from counterlight.errors import InputError
from counterlight.passes.colour import LUMINANCE
from counterlight.pipeline.content import BRIGHT_PERCENTILE
from counterlight.pipeline.drift import Moved, positions, resampled, sampled
from counterlight.raster import Region
from counterlight.tools.acquisition.plan import MAD_TO_SIGMA, Noise
from counterlight.tools.transport.transport import Csr, Transport, luminance, luminance_matrix

SMOOTH, OCTAVES = 1.5, 4  # σ of the finest of the picture's octaves, in projector pixels; number of octaves
CONTRAST, DARKEST = 0.22, 0.02  # the picture's standard deviation and least light; its mean is 0.5
LEAST_SCALE = 1e-3  # least scale of the residuals, in multiples of σ
FARTHEST = 4  # whole-pixel shifts are searched up to 1/FARTHEST of a side
MODEL = 0.01  # error assumed of T, as a share of a camera pixel's floodlight
STAGES = 2, 6, 8  # unknowns: a shift, an affinity, a homography
STEPS, STILL = 15, 1e-4  # steps per stage; a stage ends when no corner moves by more than this number of pixels
CAUCHY = 2.385  # σ: 95 % as good as least squares where noise is normal (Holland and Welsch 1977)
MOST_UNSURE = 0.05  # projector pixels; a stage with a larger deviation of its corners is rejected
WORTH = 4.0  # least improvement per further unknown, relative to the improvement that noise alone gives
FEWEST = 50  # camera pixels, for eight unknowns and noise
TELLS = 0.1  # share of the brightest prediction; only brighter camera pixels determine the gain
LIT = 0.01  # share of the bright pixels' floodlight; only brighter camera pixels are used


@dataclass(frozen=True)
class Registration:
    """The position of the picture.

    moved : homography, with the gain of each channel.
    unsure : standard deviation of the corners, projector pixels.
    unknowns : number of unknowns, from STAGES.
    agreement : correlation of predicted and captured picture, each relative to the floodlight. Low if there is no such
        picture.
    """

    moved: Moved
    unsure: float
    unknowns: int
    agreement: float


def random_field(shape: tuple[int, int], seed: int = 0) -> FloatArray:
    """Returns a smooth random picture of linear light, (height, width), 0 to 1."""
    rng = np.random.default_rng(seed)
    field = np.zeros(shape)
    for octave in range(OCTAVES):
        noise = ndimage.gaussian_filter(rng.standard_normal(shape), SMOOTH * 2**octave, mode="reflect")
        field += noise / noise.std()
    return np.asarray(np.clip(0.5 + CONTRAST * field / field.std(), DARKEST, 1 - DARKEST))


class Registrar:
    """Finds the picture of one projector of a raster.

    counts : (camera height, camera width) bool. Camera pixels to use; InputError for too few.
    """

    def __init__(self, transport: Transport, region: Region, counts: BoolArray) -> None:
        assert transport.projector is not None
        number = np.arange(transport.shape[1]).reshape(transport.projector)
        self._columns = number[region.part].ravel()
        self._transport, self._shape = transport, (region.height, region.width)
        flood = luminance(self._seen(np.ones((*self._shape, 3))))
        self._rows = np.flatnonzero(counts.ravel() & lit(flood))
        self.flood = flood[self._rows]
        if len(self._rows) < FEWEST:
            raise InputError(
                f"a picture is seen by {len(self._rows)} camera pixels that count, expected {FEWEST} or more: "
                "is the camera overexposed, or looking elsewhere?"
            )
        self.near = _without_far(transport, self._rows, self._columns)

    def find(self, drive: FloatArray, seen: FloatArray, noise: Noise) -> Registration:
        """Register the picture.

        drive : (height, width, 3). Picture shown in the region.
        seen : (camera pixels, 3). Light above black of that picture alone.
        """
        problem = _Problem(self, drive, seen[self._rows], noise)
        best = problem.descend(self._whole_shift(drive, luminance(seen)[self._rows]), STAGES[0])
        for unknowns in STAGES[1:]:
            found = problem.descend(best.theta, unknowns)
            worth = (best.cost - found.cost) / found.scale**2 > WORTH * (unknowns - best.unknowns)
            if worth and found.unsure < MOST_UNSURE:
                best = found
        N = np.linalg.inv(homography(best.theta, self._shape))
        moved = Moved(np.asarray(N / N[2, 2]), best.gain)
        return Registration(moved, best.unsure, best.unknowns, problem.agreement(best.theta))

    def predicted(self, shown: FloatArray) -> FloatArray:
        """Returns the light predicted for a region's drive (height, width, 3) at the pixels used: (pixels, 3)."""
        return self._seen(shown)[self._rows]

    def _seen(self, shown: FloatArray) -> FloatArray:
        whole = np.zeros((self._transport.shape[1], 3))
        whole[self._columns] = shown.reshape(-1, 3)
        return self._transport.apply(whole)

    def _whole_shift(self, drive: FloatArray, light: FloatArray) -> FloatArray:
        """Returns θ of the best whole shift: the peak of Σ q(u) p(u − s) divided by the root of p's energy there."""
        share = light / self.flood
        gathered = self.near.T @ ((share - share.mean()) / self.flood)
        weight = self.near.T @ (1 / self.flood)
        picture = luminance(drive.reshape(-1, 3)).reshape(self._shape)
        picture = picture - picture.mean()
        score = correlated(gathered.reshape(self._shape), picture)
        energy = correlated(weight.reshape(self._shape), picture**2)
        score /= np.sqrt(np.maximum(energy, 1e-3 * energy.max()))
        theta = np.zeros(8)
        theta[:2] = -best_shift(score) / _half(self._shape)
        return theta


def _without_far(transport: Transport, rows: IntArray, columns: IntArray) -> Csr | LinearOperator:
    """Returns S + B P of luminance, restricted to some camera and projector pixels."""
    near = Csr(luminance_matrix(transport.near)[rows][:, columns])
    if transport.blurred is None:
        return near
    B, P = (luminance_matrix(part) for part in (transport.blurred.scatter, transport.blurred.gather))
    return aslinearoperator(near) + aslinearoperator(B[rows]) @ aslinearoperator(P[:, columns])


@dataclass(frozen=True)
class _Fit:
    """A fit of one stage.

    theta : θ, the unknowns of M.
    gain : (3,).
    cost : robust sum of squares, relative to the expected noise.
    scale : robust deviation of the residuals, in σ.
    unsure : standard deviation of the corners, projector pixels.
    """

    theta: FloatArray
    gain: FloatArray
    cost: float
    scale: float
    unsure: float
    unknowns: int


class _Problem:
    """Minimises the difference between captured and predicted light over M and g."""

    def __init__(self, registrar: Registrar, drive: FloatArray, seen: FloatArray, noise: Noise) -> None:
        self._registrar, self._drive, self._seen = registrar, drive, seen
        self._shape = drive.shape[0], drive.shape[1]
        self._light = luminance(seen)
        self._sigma = np.hypot(luminance(noise.sigma(seen)), MODEL * registrar.flood)
        picture = luminance(drive.reshape(-1, 3)).reshape(self._shape)
        self._slopes = np.stack(np.gradient(picture)[::-1], axis=2)
        self._u = normal_positions(self._shape)

    def agreement(self, theta: FloatArray) -> float:
        """Returns the correlation of predicted and captured light, each relative to the floodlight."""
        seen = self._light / self._registrar.flood
        predicted = seen - self._residual(theta)[0] * self._sigma / self._registrar.flood
        return float(np.nan_to_num(np.corrcoef(seen, predicted)[0, 1]))

    def descend(self, theta: FloatArray, unknowns: int) -> _Fit:
        """Descend from θ, changing only the first `unknowns` unknowns."""
        spread: FloatArray = np.eye(unknowns)
        for _ in range(STEPS):
            residual, gain = self._residual(theta)
            J = self._jacobian(theta, unknowns) * float(LUMINANCE @ gain)
            J /= self._sigma[:, None]
            scale = robust_scale(residual, LEAST_SCALE)
            weights = cauchy_weights(residual, scale)
            J = np.column_stack([J, (self._light - residual * self._sigma) / self._sigma])  # column of the gain
            spread = np.asarray(np.linalg.pinv(J.T @ (weights[:, None] * J), hermitian=True))
            step = (spread @ (J.T @ (weights * residual)))[:unknowns]
            theta = theta.copy()
            theta[:unknowns] += step
            spread = scale**2 * spread[:unknowns, :unknowns]
            if np.abs(step).max() * _half(self._shape) < STILL:
                break
        residual, gain = self._residual(theta)
        unsure = float(np.sqrt(np.trace(spread)) * _half(self._shape))
        return self._fit(theta, gain, residual, unsure, unknowns)

    def _fit(self, theta: FloatArray, gain: FloatArray, residual: FloatArray, unsure: float, unknowns: int) -> _Fit:
        cost = float(np.sum(CAUCHY**2 * np.log1p((residual / CAUCHY) ** 2)))
        return _Fit(theta, gain, cost, robust_scale(residual, LEAST_SCALE), unsure, unknowns)

    def _residual(self, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Returns the residual in σ, and each channel's gain."""
        M = homography(theta, self._shape)
        predicted = self._registrar.predicted(resampled(self._drive, M))
        pairs = zip(self._seen.T, predicted.T, strict=True)
        gain = np.array([_gain(*pair) for pair in pairs])
        return (self._light - luminance(gain * predicted)) / self._sigma, gain

    def _jacobian(self, theta: FloatArray, unknowns: int) -> FloatArray:
        """Returns the derivative of the prediction by the first unknowns, per unit gain: (pixels, unknowns)."""
        at = positions(homography(theta, self._shape), self._shape)[0].reshape(-1, 2)
        slopes = sampled(self._slopes, at)
        u, (_, scaled, w) = self._u, _mapped(theta, self._u)
        moves = [
            slopes[:, 0],
            slopes[:, 1],
            *(slopes[:, i] * u[:, j] for i in range(2) for j in range(2)),
            *(-(slopes * scaled).sum(axis=1) * u[:, j] for j in range(2)),
        ]
        columns = np.stack(moves[:unknowns], axis=1) * (_half(self._shape) / w)[:, None]
        return np.asarray(self._registrar.near @ columns)


def _gain(seen: FloatArray, predicted: FloatArray) -> float:
    """Returns the median gain, which a person in the light does not change; 1 if no pixel is bright enough."""
    clear = predicted > TELLS * max(float(predicted.max()), 0.0)
    return float(np.median(seen[clear] / predicted[clear])) if clear.any() else 1.0


def lit(flood: FloatArray) -> BoolArray:
    """Whether camera pixels are bright enough to be used, from their floodlight."""
    return np.asarray(flood > LIT * np.percentile(flood, BRIGHT_PERCENTILE))


def robust_scale(residual: FloatArray, least: float) -> float:
    """Returns the standard deviation of most residuals, from their median."""
    return max(float(MAD_TO_SIGMA * np.median(np.abs(residual))), least)


def cauchy_weights(residual: FloatArray, scale: float) -> FloatArray:
    """Returns least-squares weights that nearly ignore outliers."""
    return np.asarray(1 / (1 + (residual / (CAUCHY * scale)) ** 2))


def _half(shape: tuple[int, int]) -> float:
    return max(shape) / 2


def normal_positions(shape: tuple[int, int]) -> FloatArray:
    """Returns pixel centres relative to the middle, in halves of the longer side: (pixels, 2)."""
    y, x = np.mgrid[: shape[0], : shape[1]] + 0.5
    return np.stack([x - shape[1] / 2, y - shape[0] / 2], axis=2).reshape(-1, 2) / _half(shape)


def _mapped(theta: FloatArray, u: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns q = (1 + A) u + t, q / w and w = 1 + g u; θ is t, then A row by row, then g."""
    w = 1 + u @ theta[6:8]
    q = u + u @ theta[2:6].reshape(2, 2).T + theta[:2]
    return q, q / w[:, None], w


def homography(theta: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """Returns M for positions in pixels from the upper left corner."""
    own = np.eye(3)
    own[:2, :2] += theta[2:6].reshape(2, 2)
    own[:2, 2], own[2, :2] = theta[:2], theta[6:8]
    half = _half(shape)
    to_pixels = np.array([[half, 0, shape[1] / 2], [0, half, shape[0] / 2], [0, 0, 1]])
    M = to_pixels @ own @ np.linalg.inv(to_pixels)
    return np.asarray(M / M[2, 2])


def correlated(
    where: NDArray[np.floating], picture: NDArray[np.floating], farthest: int = FARTHEST, beyond: float = 0.0
) -> FloatArray:
    """Returns Σ_u where(u) picture(u − s) for every shift s; `beyond` for shifts over 1/`farthest` of a side."""
    padded = tuple(2 * n for n in picture.shape)
    product = fft.rfft2(where, padded) * np.conj(fft.rfft2(picture, padded))
    sums = fft.irfft2(product, padded)
    for axis, n in enumerate(picture.shape):
        far = np.abs(np.fft.fftfreq(padded[axis], 1 / padded[axis])) > n // farthest
        sums[(slice(None),) * axis + (far,)] = beyond
    return np.asarray(sums)


def best_shift(sums: FloatArray) -> FloatArray:
    """Returns the shift (right, down) of the peak in the result of `correlated`."""
    peak = np.unravel_index(np.argmax(sums), sums.shape)
    down, right = (np.fft.fftfreq(n, 1 / n)[i] for n, i in zip(sums.shape, peak, strict=True))
    return np.array([right, down])

"""Radiance from several exposures: each method is the quotient of two weighted sums over the pictures.

For one pixel and channel with code z_j in picture j of exposure time t_j, w the weight, f⁻¹ the response:

- debevec:   ln E = Σ w(z_j) (ln f⁻¹(z_j) − ln t_j) / Σ w(z_j)         thesis eq. 3.4, Debevec and Malik 1997, eq. 6
- robertson:    E = Σ w(z_j) t_j f⁻¹(z_j) / Σ w(z_j) t_j²              thesis eq. 3.6, Robertson et al. 2003, eq. 9
- average:      E = Σ f⁻¹(z_j) / Σ t_j                                 repeated shots, t_j all the same

All have the form Σ (α_j p(z_j) + β_j q(z_j)) / Σ γ_j q(z_j), with a table (p, q) common to all pictures and three
numbers per picture, so that one loop on the CPU and one shader compute them all.

Codes in the top fiftieth of the range count as clipped. JPEG puts such codes into clipped areas, where the longest
exposures contain no information but have most weight in eq. 3.6. Where a code is clipped, the light is at least
f⁻¹(z_top)/t_j. A pixel gets this bound instead of an estimate if all its codes have weight 0, or if its estimate lies
well below the bound.

The sums are computed over pictures that arrive one at a time, on the CPU or on the GPU.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from math import log
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray

STEEPNESS = 4.0  # W of thesis eq. 3.7; Robertson et al. (2003) and OpenCV use the same
CHUNK_PIXELS = 1 << 15  # pixels processed at a time, so that their sums stay in the cache


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


MARGIN = 0.02  # share of the range; codes in the top margin count as clipped
SLACK = 0.9  # share of the bound that an estimate must reach; allows for noise and rounding
USUAL_WEIGHTING = {"debevec": "hat", "robertson": "gaussian"}


@dataclass(frozen=True, eq=False)
class Estimator:
    """One of the methods MERGES for one camera.

    table : (levels, channels, 2). p and q of each code value.
    top : the lowest code that counts as clipped; from there on, q is 0 and p is the exposure that the light exceeds.
    """

    method: str
    table: FloatArray
    top: int

    @property
    def exponential(self) -> bool:
        """Whether the quotient is ln E instead of E."""
        return self.method == "debevec"

    def coefficients(self, exposure_s: float) -> tuple[float, float, float]:
        """Returns the coefficients α, β and γ of a picture, which the module's equation defines."""
        return {
            "debevec": (1.0, -log(exposure_s), 1.0),
            "robertson": (exposure_s, 0.0, exposure_s**2),
            "average": (1.0, 0.0, exposure_s),
        }[self.method]


def make_estimator(method: str, exposure: FloatArray, weights: FloatArray, *, margin: float = MARGIN) -> Estimator:
    """Make the table of a method.

    exposure : (levels, channels). f⁻¹ of each code value; positive where the weight is.
    weights : (levels,). w; unused by `average`.
    margin : share of the range; codes in the top margin count as clipped.
    """
    top = int(np.ceil((1 - margin) * (len(exposure) - 1)))
    q = np.ones(exposure.shape) if method == "average" else np.repeat(weights[:, None], exposure.shape[1], axis=1)
    q[top:] = 0
    p = np.zeros(exposure.shape)
    used = q > 0
    p[used] = q[used] * (np.log(exposure[used]) if method == "debevec" else exposure[used])
    p[top:] = exposure[top]
    return Estimator(method, np.stack([p, q], axis=-1), top)


class ExposureSums(Protocol):
    """Adds pictures of one shape; stores the sums, not the pictures."""

    def add(self, codes: NDArray[Any], coefficients: tuple[float, float, float], exposure_s: float) -> None:
        """Add a picture; `codes` is (height, width, channels), unsigned."""

    def estimate(self) -> NDArray[np.float32]:
        """Returns the radiance, (height, width, channels), and resets; −bound where it is unknown (0: only black)."""


class CpuSums:
    """ExposureSums in numpy, float64; matches gl.exposure_sums.GlSums. Takes 20 bytes per pixel and channel."""

    def __init__(self, estimator: Estimator, shape: tuple[int, int, int]) -> None:
        self._estimator, self._shape = estimator, shape
        planes = shape[2], shape[0] * shape[1]
        self._sum, self._weight = np.zeros(planes), np.zeros(planes)
        self._bound = np.zeros(planes, np.float32)

    def add(self, codes: NDArray[Any], coefficients: tuple[float, float, float], exposure_s: float) -> None:
        terms, weights = _tables(self._estimator, coefficients)
        bounds = (self._estimator.table[-1, :, 0] / exposure_s).astype(np.float32)
        pixels = codes.reshape(-1, self._shape[2])
        for start in range(0, len(pixels), CHUNK_PIXELS):
            part = slice(start, start + CHUNK_PIXELS)
            for channel, z in enumerate(np.ascontiguousarray(pixels[part].T)):
                self._sum[channel, part] += terms[channel].take(z, mode="clip")  # all codes are within the table
                self._weight[channel, part] += weights[channel].take(z, mode="clip")
                limits = self._bound[channel, part]
                np.maximum(limits, bounds[channel] * (z >= self._estimator.top), out=limits)

    def estimate(self) -> NDArray[np.float32]:
        result = np.empty(self._sum.shape, np.float32)
        for start in range(0, result.shape[1], CHUNK_PIXELS):
            part = np.s_[:, start : start + CHUNK_PIXELS]
            known = self._weight[part] > 0
            value = np.divide(self._sum[part], self._weight[part], out=np.zeros(known.shape), where=known)
            if self._estimator.exponential:
                np.exp(value, out=value)
            known &= value >= SLACK * self._bound[part]
            result[part] = np.where(known, value, -self._bound[part])
        for planes in (self._sum, self._weight, self._bound):
            planes.fill(0)
        return np.ascontiguousarray(result.T).reshape(self._shape)


@lru_cache(maxsize=16)
def _tables(estimator: Estimator, coefficients: tuple[float, float, float]) -> tuple[FloatArray, FloatArray]:
    """Returns what a picture with these coefficients adds to both sums by its codes, (channels, levels) each."""
    alpha, beta, gamma = coefficients
    p, q = np.ascontiguousarray(estimator.table.T)
    return np.where(q > 0, alpha * p + beta * q, 0), gamma * q


@contextmanager
def summing(estimator: Estimator, shape: tuple[int, int, int], *, gpu: bool) -> Iterator[ExposureSums]:
    """Returns sums on the CPU or, through EGL, on the GPU; InputError without OpenGL or enough memory."""
    if not gpu:
        yield CpuSums(estimator, shape)
        return
    from counterlight.gl.context import headless_context  # imported late, because only the GPU needs OpenGL
    from counterlight.gl.exposure_sums import GlSums

    parameters = estimator.table, shape, estimator.exponential, SLACK
    with headless_context("leave --gpu out") as context, GlSums(context, *parameters) as sums:
        yield sums

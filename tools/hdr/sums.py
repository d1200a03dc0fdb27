"""The two sums of an estimator over pictures that arrive one at a time: on the CPU, and the choice of CPU or GPU."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from counterlight.tools.hdr.estimators import SLACK, Estimator

CHUNK_PIXELS = 1 << 15  # pixels processed at a time, so that their sums stay in the cache


class ExposureSums(Protocol):
    """Adds pictures of one shape; stores the sums, not the pictures."""

    def add(self, codes: NDArray[Any], coefficients: tuple[float, float, float], exposure_s: float) -> None:
        """Add a picture; `codes` is (height, width, channels), unsigned."""

    def estimate(self) -> NDArray[np.float32]:
        """Returns (height, width, channels) and resets: the radiance, or −bound where there is none (0: only black)."""


class CpuSums:
    """ExposureSums in numpy, float64; matches gl.exposure_sums.GlSums. Takes 20 bytes per pixel and channel."""

    def __init__(self, estimator: Estimator, shape: tuple[int, int, int]) -> None:
        self._estimator, self._shape = estimator, shape
        planes = shape[2], shape[0] * shape[1]
        self._sum, self._weight = np.zeros(planes), np.zeros(planes)
        self._bound = np.zeros(planes, np.float32)

    def add(self, codes: NDArray[Any], coefficients: tuple[float, float, float], exposure_s: float) -> None:
        alpha, beta, gamma = coefficients
        p, q = np.ascontiguousarray(self._estimator.table.T)
        terms, weights = np.where(q > 0, alpha * p + beta * q, 0), gamma * q
        bounds = (p[:, -1] / exposure_s).astype(np.float32)
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

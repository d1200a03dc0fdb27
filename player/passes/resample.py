"""Places a picture along one axis of a target with a tent filter; x then y place a picture."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from counterlight.passes.drawing import CHANNELS, Array, Pass, Picture, flat
from counterlight.passes.kernel import PICTURE, PLANE, Whole, kernel, prange


@dataclass(frozen=True, eq=False)
class Resample(Pass[Picture]):
    """The source along one axis; black outside the placed interval.

    axis : 0 for x, 1 for y.
    origin, extent : the source covers origin … origin + extent of the target.
    """

    shader = "resample.frag"
    source: Picture
    axis: int
    origin: float
    extent: float

    def fill(self: "Resample[Array]", out: Array) -> None:
        along = 1 - self.axis
        first, weights = tents(self.source.shape[along], out.shape[along], self.origin, self.extent)
        if along:
            across(self.source, first, weights, out)
        else:
            down(flat(self.source), first, weights, flat(out))


def resample(picture: NDArray[np.floating], target: tuple[int, int], placement: tuple[int, int, int, int]) -> Array:
    """Return a picture (height, width, 3) placed in a black target (height, width), as the player places it.

    placement : left, top, width, height.
    """
    left, top, width, height = placement
    between = np.zeros((picture.shape[0], target[1], CHANNELS), np.float32)
    Resample(np.ascontiguousarray(picture, np.float32), 0, left, width).fill(between)
    placed = np.zeros((*target, CHANNELS), np.float32)
    Resample(between, 1, top, height).fill(placed)
    return placed


@lru_cache(maxsize=8)
def tents(count: int, length: int, origin: float, extent: float) -> tuple[Whole, Array]:
    """Return the tent filters of an axis as bands: the first sample (length,) and the weights (length, taps).

    A filter is as wide as a target pixel, and at least as wide as one of the `count` source pixels.
    """
    scale = count / extent
    centre = (np.arange(length) + 0.5 - origin) * scale
    radius = max(scale, 1.0)
    taps = min(int(np.ceil(2 * radius)) + 1, count)
    first = np.clip(np.ceil(centre - radius - 0.5), 0, count - taps).astype(np.int32)
    weights = np.maximum(0, 1 - np.abs(first[:, None] + np.arange(taps) + 0.5 - centre[:, None]) / radius)
    weights[(centre <= 0) | (centre >= count)] = 0
    total = weights.sum(axis=1, keepdims=True)
    return first, np.divide(weights, total, out=np.zeros_like(weights), where=total > 0).astype(np.float32)


@kernel(f"{PICTURE}, int32[::1], {PLANE}, {PICTURE}")
def across(source: Array, first: Whole, weights: Array, out: Array) -> None:
    """Filter along x (resample): pixel x of a row sums weights[x] times the source pixels from first[x] on."""
    taps = weights.shape[1]
    for y in prange(out.shape[0]):
        for x in range(out.shape[1]):
            red, green, blue = np.float32(0), np.float32(0), np.float32(0)
            for k in range(taps):
                weight, at = weights[x, k], first[x] + k
                red += weight * source[y, at, 0]
                green += weight * source[y, at, 1]
                blue += weight * source[y, at, 2]
            out[y, x, 0], out[y, x, 1], out[y, x, 2] = red, green, blue


@kernel(f"{PLANE}, int32[::1], {PLANE}, {PLANE}")
def down(source: Array, first: Whole, weights: Array, out: Array) -> None:
    """Filter along y (resample). source, out : (rows, values)."""
    for y in prange(out.shape[0]):
        for i in range(out.shape[1]):
            out[y, i] = weights[y, 0] * source[first[y], i]
        for k in range(1, weights.shape[1]):
            if weights[y, k] != 0:
                for i in range(out.shape[1]):
                    out[y, i] += weights[y, k] * source[first[y] + k, i]

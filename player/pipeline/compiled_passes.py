"""Passes of cpu_renderer.py over the kernels of compiled.py, named after the shaders that they replace."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from counterlight.pipeline import compiled, compiled_drift
from counterlight.pipeline.adaptation import Limits, samples, tried
from counterlight.pipeline.reference import MOST_TAPS
from counterlight.pipeline.reference_renderer import Held

Picture = NDArray[np.float32]
Whole = NDArray[np.int32]
NOTHING = np.zeros((0, 0, 0), np.float32)
NO_SQUARES = np.zeros(0, np.float32)


class Drawn(Held):
    """A pass that draws into its own target, as on a GPU. Its result is valid until the pass runs again.

    draw : function that fills the target, its first argument.
    uniforms : further arguments of `draw`, named as in the CPU function of reference.py.
    """

    def __init__(self, draw: Callable[..., None], shape: tuple[int, int], uniforms: dict[str, Any]) -> None:
        self.target: Picture = np.zeros((*shape, 3), np.float32)
        self._draw, self._uniforms = draw, uniforms

    def set(self, **uniforms: Any) -> None:
        self._uniforms |= uniforms

    def clear(self) -> None:
        self.target.fill(0)

    def run(self, **pictures: Any) -> Picture:
        self._draw(self.target, **pictures, **self._uniforms)
        return self.target


def desired(
    out: Picture,
    *,
    picture: Picture,
    ambient: Picture,
    white: float,
    tone: NDArray[np.floating] | tuple[float, float] = (1.0, 0.0),
    unit: float = 1.0,
    black_level: float = 0.0,
    full: Picture = NOTHING,
    clamp: bool = False,
    row_red: Picture = NOTHING,
    row_green: Picture = NOTHING,
    row_blue: Picture = NOTHING,
    squares: NDArray[np.float32] = NO_SQUARES,
) -> None:
    scale, offset = (float(value) for value in np.ravel(tone)[:2])
    gain = np.float32(white * scale * (1 - black_level) * unit)
    lift = np.float32(white * (scale * black_level + offset))
    compiled.desired(picture, ambient, gain, lift, row_red, row_green, row_blue, clamp, full, squares, out)


def combine(out: Picture, *, first: Picture, second: Picture, factor: float, clamp: bool = False) -> None:
    compiled.combined(np.float32(1), flat(first), np.float32(factor), flat(second), clamp, flat(out))


def blend(out: Picture, *, now: Picture, before: Picture, weight: float, gain: float = 1.0) -> None:
    compiled.combined(np.float32(1 - weight), flat(now), np.float32(weight * gain), flat(before), False, flat(out))


def resample(out: Picture, *, source: Picture, axis: int, origin: float, extent: float) -> None:
    """Filter along one axis. axis : 0 for x, 1 for y, as in the shader."""
    along = 1 - axis
    first, weights = tents(source.shape[along], out.shape[along], origin, extent)
    if along:
        compiled.across(source, first, weights, out)
    else:
        compiled.down(flat(source), first, weights, flat(out))


def pinned(
    out: Picture, *, source: Picture, to_source: tuple[float, ...], across: Picture = NOTHING, down: Picture = NOTHING
) -> None:
    H = np.ascontiguousarray(np.reshape(to_source, (3, 3)).T, np.float64)
    compiled.pinned(source, H, MOST_TAPS, across, down, out)


def moved(out: Picture, *, drive: Picture, projectors: Picture) -> None:
    for rows in projectors.astype(np.float64):
        region = [int(value) for value in (*rows[3, :2], *rows[4, :2])]
        compiled_drift.moved(drive, rows[:3], rows[5], *region, out)


def clip_sums(
    u: NDArray[np.floating], near: Picture, limits: Limits, white: float, budget: float, offset: float | None
) -> NDArray[np.float64]:
    """Compiled version of adaptation.clip_sums."""
    told, (offsets, shares), sums = vars(limits).values(), tried(offset), np.empty(16)
    pace = np.float32(white), np.float32(budget), offsets, shares, offset is not None
    compiled.clip_sums(u.astype(np.float32), near, *told, *samples(u.shape[:2]), *pace, sums)
    return sums


@lru_cache(maxsize=8)
def tents(count: int, length: int, origin: float, extent: float) -> tuple[Whole, Picture]:
    """Return the filters of resample_axis as bands: the first sample (length,) and the weights (length, taps)."""
    scale = count / extent
    centre = (np.arange(length) + 0.5 - origin) * scale
    radius = max(scale, 1.0)
    taps = min(int(np.ceil(2 * radius)) + 1, count)
    first = np.clip(np.ceil(centre - radius - 0.5), 0, count - taps).astype(np.int32)
    weights = np.maximum(0, 1 - np.abs(first[:, None] + np.arange(taps) + 0.5 - centre[:, None]) / radius)
    weights[(centre <= 0) | (centre >= count)] = 0
    total = weights.sum(axis=1, keepdims=True)
    return first, np.divide(weights, total, out=np.zeros_like(weights), where=total > 0).astype(np.float32)


def flat(picture: Picture) -> Picture:
    """View as (rows, values)."""
    return picture.reshape(picture.shape[0], -1)


PASSES: dict[str, Callable[..., None]] = {
    "blend.frag": blend,
    "combine.frag": combine,
    "desired.frag": desired,
    "moved.frag": moved,
    "pinned.frag": pinned,
    "resample.frag": resample,
}

"""Combine light measured at several levels into the best estimate from all captures.

A block's light is measured twice: in its own capture, and as the sum of its quarters, which hold as much light and so
as many photons. On a tree of such measurements the least-squares estimate takes two passes (Chou, Willsky and
Benveniste 1994, Multiscale recursive estimation). Upwards, each block's two values are averaged, weighted by their
variance. Downwards, the difference between a block's estimate and the sum of its quarters is distributed to the
quarters by their variance.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import BoolArray, FloatArray
from counterlight.tools.acquisition.schemes.blocks import NO_CHILD, BlockGrid, BlockLight, joined

TINY = np.finfo(float).tiny
SOME = 1 << 18


@dataclass(frozen=True)
class Reading:
    """Light of the quarters of each parent, as the captures of one level give it.

    light : (entries, 4, 3). Radiance as measured, possibly negative; 0 where the projector has no such quarter.
    variance : (entries, 4, 3). Variance of the light.
    lit : (entries, 4) bool. Whether the quarter is measurable.
    rest : (entries,) bool. Whether the remainder outside the lit quarters is measurable.
    """

    light: NDArray[np.floating]
    variance: NDArray[np.floating]
    lit: BoolArray
    rest: BoolArray

    def quarters(self, part: slice) -> "Estimate":
        """Returns the estimate of some entries, (entries, 4, 3)."""
        return Estimate(*(each[part].astype(np.float64) for each in (self.light, self.variance)))


@dataclass(frozen=True)
class Estimate:
    """A value and its variance, both (…, 3)."""

    light: FloatArray
    variance: FloatArray

    def averaged(self, other: "Estimate") -> "Estimate":
        """Combine with an independent estimate, each weighted by the inverse of its variance."""
        total = np.maximum(self.variance + other.variance, TINY)
        light = (self.light * other.variance + other.light * self.variance) / total
        return Estimate(light, self.variance * other.variance / total)

    def summed(self) -> "Estimate":
        """Sum over a parent's quarters."""
        return Estimate(self.light.sum(axis=1), self.variance.sum(axis=1))


def agree(root: BlockLight, variance: FloatArray, readings: Sequence[Reading]) -> list[BlockLight]:
    """Estimate all light, and keep it at the levels that `keep_measurable` chooses.

    root : blocks of level 0 as measured; the lit quarters of each level, in order, are the parents of the next.
    variance : (entries, 3). Variance of root.
    readings : one per level; their arrays are overwritten.
    """
    if not readings:
        return [root]
    for coarse, fine in reversed(list(pairwise(readings))):
        _average_with_quarters(coarse, fine)
    light = Estimate(root.light.astype(np.float64, copy=False), variance)
    light = light.averaged(readings[0].quarters(slice(None)).summed())
    parents = BlockLight(root.grid, root.camera, root.block, np.maximum(light.light, 0))
    parts: list[BlockLight] = []
    for reading in readings:
        _share_what_is_missing(parents, reading)
        parents, settled = keep_measurable(parents, reading.light, reading.lit, reading.rest)
        parts += settled
    return [*parts, parents]


def _average_with_quarters(coarse: Reading, fine: Reading) -> None:
    """Upward pass: average the measured light of lit quarters with the sums of their own quarters."""
    done = 0
    for part in parts_of(len(coarse.lit)):
        lit = coarse.lit[part]
        own, these = coarse.quarters(part), slice(done, done + int(lit.sum()))
        better = Estimate(own.light[lit], own.variance[lit]).averaged(fine.quarters(these).summed())
        coarse.light[part][lit], coarse.variance[part][lit] = better.light, better.variance
        done = these.stop


def _share_what_is_missing(parents: BlockLight, reading: Reading) -> None:
    """Downward pass: distribute the difference between a parent and its quarters by the quarters' variance."""
    for part in parts_of(len(reading.lit)):
        shared = (reading.lit[part] | reading.rest[part, None])[..., None]
        quarters = reading.quarters(part)
        weight = quarters.variance * shared
        weight /= np.maximum(weight.sum(axis=1, keepdims=True), TINY)
        missing = parents.light[part] - np.sum(quarters.light * shared, axis=1)
        reading.light[part] = np.maximum(quarters.light + weight * missing[:, None], 0)


def parts_of(count: int, some: int = SOME) -> Iterator[slice]:
    """Returns slices of the entries (one empty slice for none), because arrays of all would exceed the memory."""
    return (slice(first, min(first + some, count)) for first in range(0, max(count, 1), some))


def keep_measurable(
    parents: BlockLight, quarters: NDArray[np.floating], lit: BoolArray, rest: BoolArray
) -> tuple[BlockLight, list[BlockLight]]:
    """Keep each parent's energy once, at the last level at which it was measurable.

    quarters : (entries, 4, 3). Light of each parent's quarters; negative values count as 0.
    lit : (entries, 4) bool. Whether the quarter exists and is measurable.
    rest : (entries,) bool. Whether the remainder outside the lit quarters is measurable.

    Returns the lit quarters, and the rest. A parent without lit quarters keeps its own light. The remainder of other
    parents is shared by their unlit quarters in proportion to their area.
    """
    finer = BlockGrid(parents.grid.projector, parents.grid.side // 2)
    each = (
        _kept(parents.select(part), finer, quarters[part], lit[part], rest[part]) for part in parts_of(lit.shape[0])
    )
    measured, dim = (joined(parts) for parts in zip(*each, strict=True))
    return measured, [parents.select(np.asarray(~lit.any(axis=1))), dim]


def _kept(
    parents: BlockLight, finer: BlockGrid, quarters: NDArray[np.floating], lit: BoolArray, rest: BoolArray
) -> tuple[BlockLight, BlockLight]:
    """Returns the lit quarters, and the light of the other quarters of parents that have a lit quarter."""
    children, quarters = parents.grid.children[parents.block], np.maximum(quarters, 0)
    entry, quarter = np.nonzero(lit)
    measured = BlockLight(finer, parents.camera[entry], children[entry, quarter], quarters[entry, quarter])
    left = np.maximum(parents.light - np.sum(quarters * lit[..., None], axis=1), 0)
    dim = ~lit & (children != NO_CHILD) & (lit.any(axis=1) & rest)[:, None]
    area = np.where(dim, finer.area[children], 0)
    share = area / np.maximum(area.sum(axis=1, keepdims=True), 1)
    entry, quarter = np.nonzero(dim)
    light = (left[entry] * share[entry, quarter][:, None]).astype(quarters.dtype, copy=False)
    return measured, BlockLight(finer, parents.camera[entry], children[entry, quarter], light)

"""Fit T: places, far light, spots, and the brightness of each camera pixel."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray, IntArray
from counterlight.maps.row_map import SparseRows
from counterlight.tools.acquisition.few.far import Far, likeliest
from counterlight.tools.acquisition.few.near import Windows, near_light
from counterlight.tools.acquisition.few.order import PERIOD, PRIMARIES, RAMPS
from counterlight.tools.acquisition.few.places import Spots, averaged
from counterlight.tools.acquisition.few.seen import Seen, Table, some
from counterlight.tools.transport.transport import Transport

MOST_SAMPLED, MOST_OF_FAR = 20000, 6000  # camera pixels that determine smooth quantities, and far light
FAR_SHARES = np.linspace(0, 0.6, 25)
LEAST_FAR = 0.02  # share of all light; less far light is left out
ALIKE = 6.0  # σ in camera pixels over which even far light is averaged
MOST_TRIED = 4  # random pictures that separate near and far light
MISFIT = 0.01  # error assumed of spots, as a share of a pixel's light
BESIDE = PERIOD * np.array([[0, 0], [-1, 0], [1, 0], [0, -1], [0, 1]])
SPREAD = 0.7  # σ in camera pixels over which misfits are averaged
CLEARLY = 0.5  # a place is moved if the misfit falls below this share of its present value


def settled(seen: Seen, table: Table, spots: Spots, pictures: Sequence[int]) -> Spots:
    """Returns spots moved to the places that best predict these pictures."""
    misfits, weights = [], spots.seen.astype(np.float64)
    for moved in BESIDE:
        there = replace(spots, place=spots.place + moved)
        windows = Windows.around(there, np.zeros(len(there.seen)), seen.order.projector)
        (misfit,) = even_misfits(seen, table, {0.0: windows}, pictures)
        outside = np.any((there.place < -1) | (there.place > seen.order.projector), axis=1)
        around = averaged(misfit, weights, seen.camera, SPREAD)
        misfits.append(np.where(outside, np.inf, around) if moved.any() else around)
    misfits[0] *= CLEARLY
    return replace(spots, place=spots.place + BESIDE[np.argmin(misfits, axis=0)])


def even_misfits(
    seen: Seen, table: Table, tried: dict[float, Windows], pictures: Sequence[int]
) -> NDArray[np.floating]:
    """Returns the squared misfits of Gaussians plus even far light, (tried, camera pixels); 0 without a window.

    tried : the windows of each share of far light, with the same places and size.
    """
    misfits = np.zeros((len(tried), len(seen.light)))
    one = np.array([table[seen.codes[picture], np.arange(3)].mean(axis=0) for picture in pictures])
    first = next(iter(tried.values()))
    for part in some(first.pixel, 4 * len(pictures) * first.size):
        here = first.of(part)
        A = seen.drive(table, seen.mixture[here.pixel], here.columns, pictures)
        target, sigma = seen.targets(here.pixel, pictures)
        pedestal = np.einsum("pl,nkl->npk", one, seen.mixture[here.pixel]).reshape(target.shape)
        for misfit, (far, windows) in zip(misfits, tried.items(), strict=True):
            off = (1 - far) * np.einsum("new,nw->ne", A, windows.of(part).start) + far * pedestal - target
            misfit[here.pixel] = (off**2 / sigma**2).sum(axis=1) / (1 / sigma**2).sum(axis=1)
    return misfits


@dataclass(frozen=True)
class Fit:
    """A fit of T.

    kernel : (n, window). t of each window.
    primaries : F, refined from all pictures.
    """

    seen: Seen
    table: Table
    windows: Windows
    kernel: NDArray[np.float32]
    far: Far
    primaries: FloatArray

    def predicted(self, pixels: IntArray, pictures: Sequence[int]) -> FloatArray:
        """Returns the predicted light above black, (n, pictures, 3), of windows by their numbers."""
        shares = _shares(self.seen, self.table, self.windows.of(pixels), self.kernel[pixels], self.far, pictures)
        return np.asarray(np.einsum("npl,nkl->npk", shares, self.primaries[self.windows.pixel[pixels]]))

    @cached_property
    def transport(self) -> Transport:
        seen, windows, far = self.seen, self.windows, self.far
        near = np.maximum(np.einsum("nkl,nl->nk", self.primaries, 1 - far.total), 0)
        lengths = np.zeros(len(seen.light), np.int64)
        parts = [(np.zeros(0, np.int32), np.zeros((0, 3), np.float32))]
        for part in some(windows.pixel, windows.size):
            here, shares = windows.of(part), self.kernel[part]
            lengths[here.pixel] = np.count_nonzero(shares, axis=1)
            weights = (shares[..., None] * near[here.pixel, None]).astype(np.float32)
            parts.append((here.columns[shares != 0].astype(np.int32), weights[shares != 0]))
        columns, weights = (np.concatenate(each) for each in zip(*parts, strict=True))
        indptr = np.concatenate([[0], np.cumsum(lengths)])
        S = SparseRows(indptr, columns, weights, seen.order.projector[0] * seen.order.projector[1])
        return Transport(S, far.far_light(self.primaries * seen.lit[:, None, None]) if far.total.any() else None)


def fitted(seen: Seen, table: Table, spots: Spots, pictures: Sequence[int]) -> Fit:
    """Fit T to sines, ramps and some random pictures; `table` is the projector's light per code value."""
    spots = settled(seen, table, spots, [RAMPS, *pictures[:MOST_TRIED]])
    windows, far = smooth(seen, table, spots, pictures)
    kernel, far = near_light(seen, table, windows, far, [*_first_pictures(seen), *pictures] if pictures else [])
    primaries = _brightness(seen, table, windows, kernel, far, [*_first_pictures(seen), *pictures])
    return Fit(seen, table, windows, kernel, far, primaries)


def _first_pictures(seen: Seen) -> list[int]:
    return list(range(RAMPS, seen.order.least))


def smooth(seen: Seen, table: Table, spots: Spots, pictures: Sequence[int]) -> tuple[Windows, Far]:
    """Fit far light, and the windows of near light."""
    far = Far.none(seen, table)
    even = _even(seen, table, spots, [RAMPS, *pictures[:MOST_TRIED]])
    if not spots.seen.any() or np.average(even, weights=seen.clarity.sum(axis=1) * spots.seen) < LEAST_FAR:
        return Windows.around(spots, np.zeros_like(even), seen.order.projector), far
    windows = Windows.around(spots, even, seen.order.projector)
    far = _far(seen, table, windows, far, even, [*_first_pictures(seen), *pictures])
    return Windows.around(spots, _of_grey(seen, far.total), seen.order.projector), far


def _of_grey(seen: Seen, shares: FloatArray) -> FloatArray:
    """Returns the share of grey light, (camera pixels,), from the share of each primary, (camera pixels, 3)."""
    total = seen.clarity.sum(axis=1)
    summed: FloatArray = np.einsum("nk,nkl,nl->n", seen.clarity, seen.mixture, shares)
    return np.asarray(np.divide(summed, total, out=np.zeros_like(total), where=total > 0))


def sampled(windows: Windows, most: int = MOST_SAMPLED) -> IntArray:
    """Returns the indices of at most `most` windows, evenly spaced."""
    return np.arange(0, len(windows.pixel), max(1, -(-len(windows.pixel) // most)))


def _even(seen: Seen, table: Table, spots: Spots, pictures: Sequence[int]) -> FloatArray:
    """Returns the share of far light, (camera pixels,), for which spots match the contrast of these pictures."""
    windows = [Windows.around(spots, np.full(len(seen.light), share), seen.order.projector) for share in FAR_SHARES]
    tried = [(share, each.of(sampled(each))) for share, each in zip(FAR_SHARES, windows, strict=True)]
    same_size = [dict(each) for _, each in groupby(tried, lambda each: each[1].size)]
    misfits = np.concatenate([even_misfits(seen, table, each, pictures) for each in same_size])
    weights = seen.clarity.sum(axis=1) * (np.sum(misfits, axis=0) > 0)
    smoothed = [averaged(misfit, weights, seen.camera, ALIKE) for misfit in misfits]
    return np.asarray(FAR_SHARES[np.argmin(smoothed, axis=0)])


def _far(seen: Seen, table: Table, windows: Windows, far: Far, even: FloatArray, pictures: Sequence[int]) -> Far:
    """Fit far light to all camera pixels around each node, whatever the shapes of their spots."""
    nodes, unknown = far.nodes, 3 * far.cells.count
    J, h, mean = (np.zeros((nodes.count, count)) for count in (unknown * unknown, unknown, 4))
    chosen = sampled(windows, MOST_OF_FAR)
    for part in some(chosen, 6 * len(pictures) * (windows.size + unknown)):
        here = windows.of(chosen[part])
        around = nodes.textured(np.ones(len(even)))[here.pixel].T
        info, evidence = _information(seen, table, here, far, pictures)
        J += around @ info.reshape(len(info), -1)
        h += around @ evidence
        mean += around @ np.column_stack([even[here.pixel], here.place, np.ones(len(evidence))])
    mean /= np.maximum(mean[:, 3:], 1e-9)
    shares = likeliest(far.cells, mean[:, 0], mean[:, 1:3], J.reshape(-1, unknown, unknown), h)
    return replace(far, shares=shares)


def _information(
    seen: Seen, table: Table, windows: Windows, far: Far, pictures: Sequence[int]
) -> tuple[FloatArray, FloatArray]:
    """Returns Bᵀ C⁻¹ B, (n, unknowns, unknowns), and Bᵀ C⁻¹ y, (n, unknowns); C covers noise and spot shapes."""
    pixels = windows.pixel
    A = seen.drive(table, seen.mixture[pixels], windows.columns, pictures)
    target, sigma = seen.targets(pixels, pictures)
    near = seen.shares(table, windows.start, windows.columns, pictures)
    B = far.design(pixels, pictures, near) / sigma[..., None]
    y = (target - np.einsum("npl,nkl->npk", near, seen.mixture[pixels]).reshape(target.shape)) / sigma
    free = windows.freed(A / sigma[..., None])
    turned = free.transpose(0, 2, 1)
    if free.shape[1] <= free.shape[2]:
        solved = np.linalg.solve(free @ turned + np.eye(free.shape[1]), B)
    else:
        solved = B - free @ np.linalg.solve(turned @ free + np.eye(free.shape[2]), turned @ B)
    return B.transpose(0, 2, 1) @ solved, np.einsum("nec,ne->nc", solved, y)


def _shares(
    seen: Seen, table: Table, windows: Windows, kernel: NDArray[np.floating], far: Far, pictures: Sequence[int]
) -> FloatArray:
    """Returns s, the shares of each primary in each picture that the pixels see, (n, pictures, 3)."""
    near = seen.shares(table, kernel, windows.columns, pictures)
    pixels = windows.pixel
    return (1 - far.total[pixels])[:, None] * near + far.shown(pixels, pictures)


def _brightness(
    seen: Seen, table: Table, windows: Windows, kernel: NDArray[np.floating], far: Far, pictures: Sequence[int]
) -> FloatArray:
    """Fit F to all pictures, (camera pixels, channel, primary); pixels without a place keep their captured F."""
    direct = [*PRIMARIES, *seen.order.whites(seen.count)]
    of_direct = np.concatenate([np.eye(3), np.ones((len(direct) - 3, 3))])
    primaries = seen.primaries.copy()
    for part in some(np.arange(len(windows.pixel)), 8 * len(pictures) * kernel.shape[1]):
        here = windows.of(part)
        shares = _shares(seen, table, here, kernel[part], far, pictures)
        shares = np.concatenate([np.broadcast_to(of_direct, (len(shares), *of_direct.shape)), shares], axis=1)
        light = seen.captured(here.pixel, [*direct, *pictures])
        variance = seen.room.noise.sigma(light) ** 2
        variance[:, len(direct) :] += (MISFIT * seen.light[here.pixel])[:, None] ** 2
        squares = np.einsum("npl,npk,npm->nklm", shares, 1 / variance, shares, optimize=True)
        sums = np.einsum("npl,npk,npk->nkl", shares, 1 / variance, light, optimize=True)
        primaries[here.pixel] = np.linalg.solve(squares, sums[..., None])[..., 0]
    return primaries

"""Inverts large clusters through overlapping windows of the projector picture.

Rows of a damped inverse decay: a projector pixel depends on a few pixels around it. Each block of pixels therefore
solves the normal equations N x = 1_i, N = TᵀT + P + λ²I, on a window: the block and a halo. It keeps the block's rows x
Tᵀ. The residual r = N x − 1_i lies just outside the window. For any picture, the drive differs from the exact inverse's
drive p* by rᵀ p* (docs/mathematics.md 2). The halo grows per block and channel until ‖r‖₁ is within the tolerance.

With several projectors in one raster, a block's neighbours include the other projectors' pixels that light the same
places.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse

from counterlight.arrays import FloatArray, IntArray
from counterlight.raster import Region
from counterlight.tools.inverse.banded import columns_of_inverse
from counterlight.tools.inverse.rows import Piece, Truncation, truncated_piece
from counterlight.tools.jobs import run_jobs
from counterlight.tools.transport.transport import CHANNELS, Csr

BLOCKS = (16, 8, 4, 2, 1)
BLOCK_VALUES = 1 << 24  # float64 values of one block's rows, three channels (128 MiB)
HALOS = (4, 6, 8, 10, 12, 14, 17, 20, 24)
SAMPLE_WINDOWS = 5
# the decay accelerates: residuals end up to this factor below the extrapolation from the first two halos
QUICKENING = 30.0
FINEST_TOLERANCE = 0.05 / 255  # drive; windows are not widened for less


@dataclass(frozen=True)
class WindowRows:
    """Rows of T⁺ of one channel.

    camera : (m,). Camera pixels, ascending.
    columns : (m, block pixels). Each column is a row of T⁺.
    residual : (block pixels,). ‖r‖₁.
    """

    camera: IntArray
    columns: FloatArray
    residual: FloatArray


class WindowedChannel:
    """One colour channel of large clusters: T by columns, and N = TᵀT + P + λ²I; windows are parts of N.

    T : (camera pixels, projector pixels).
    damping : λ > 0.
    prior : P, (projector pixels, projector pixels).
    camera_pixels : number of camera pixels that see the projector, if T lacks some of their rows.
    """

    def __init__(self, T: Csr, damping: float, prior: Csr | None = None, camera_pixels: int | None = None) -> None:
        wide = T.astype(np.float64)
        self.camera_pixels = int(np.count_nonzero(np.diff(T.indptr))) if camera_pixels is None else camera_pixels
        self._columns = sparse.csc_array(wide)
        normal = wide.T @ wide + damping**2 * sparse.eye_array(T.shape[1])
        self._normal = sparse.csr_array(normal if prior is None else normal + prior)

    def solve(self, block: IntArray, window: IntArray) -> WindowRows:
        """Return rows `block` of T⁺, computed on `window` ⊇ block (projector pixels, both ascending)."""
        normal, outside = self._split(window)
        X = columns_of_inverse(normal, np.searchsorted(window, block))
        residual = np.abs(outside @ X).sum(axis=0)
        local = self._columns[:, window]
        camera, place = np.unique(local.indices, return_inverse=True)
        compact = sparse.csc_array((local.data, place, local.indptr), shape=(camera.size, window.size))
        return WindowRows(camera.astype(np.int64), compact @ X, residual)

    def touched(self, block: IntArray) -> IntArray:
        """Return the projector pixels that share lit camera pixels with a block, ascending."""
        return np.unique(self._normal[block].indices).astype(np.int64)

    def part(self, pixels: IntArray) -> tuple[sparse.csc_array, Csr]:
        """Return T's columns, and N's rows and columns, for some projector pixels, ascending."""
        return self._columns[:, pixels], self._normal[pixels][:, pixels]

    def _split(self, window: IntArray) -> tuple[Csr, Csr]:
        """Return N[window, window], and N[outside, window] with rows only for pixels that the window touches."""
        rows = self._normal[window]
        place = np.minimum(np.searchsorted(window, rows.indices), window.size - 1)
        inside = window[place] == rows.indices
        row = np.repeat(np.arange(window.size), np.diff(rows.indptr))
        normal = sparse.csr_array((rows.data[inside], (row[inside], place[inside])), shape=(window.size,) * 2)
        touched, outer = np.unique(rows.indices[~inside], return_inverse=True)
        shape = touched.size, window.size
        return normal, sparse.csr_array((rows.data[~inside], (outer, row[~inside])), shape=shape)


@dataclass(frozen=True)
class Windows:
    """The division of large clusters into windows.

    member : (projector height, projector width) bool. Pixels of the clusters.
    halo : first halo.
    block : side of the blocks.
    regions : regions of several projectors; empty for one.
    """

    member: NDArray[np.bool_]
    halo: int
    block: int
    regions: tuple[Region, ...] = ()

    def blocks(self) -> list[tuple[int, int]]:
        """Return the upper left corners (row, column) of the blocks with any pixel of the clusters.

        No block extends across the regions of two projectors.
        """
        corners = [
            (y, x)
            for left, top, width, height in self.regions or (self._whole,)
            for y in range(top, top + height, self.block)
            for x in range(left, left + width, self.block)
        ]
        return [corner for corner in corners if self.pixels(corner, 0).size]

    def pixels(self, corner: tuple[int, int], halo: int) -> IntArray:
        """Return the clusters' projector pixels in the block at `corner` widened by `halo`, ascending."""
        y, x = corner
        own = next((region for region in self.regions if _holds(region, y, x)), self._whole)
        below, right = min(y + self.block, own.top + own.height), min(x + self.block, own.left + own.width)
        rows, columns = slice(max(y - halo, 0), below + halo), slice(max(x - halo, 0), right + halo)
        inside_y, inside_x = np.nonzero(self.member[rows, columns])
        return np.asarray((inside_y + rows.start) * self.member.shape[1] + inside_x + columns.start, np.int64)

    def window(self, channel: WindowedChannel, corner: tuple[int, int], halo: int) -> IntArray:
        """Return a block's window, ascending: the surroundings of the block and of pixels it touches elsewhere."""
        near = self.pixels(corner, halo)
        if not self.regions:
            return near
        y, x = np.divmod(channel.touched(self.pixels(corner, 0)), self.member.shape[1])
        parts = [near]
        for region in self.regions:
            inside = _holds(region, y, x)
            if inside.any() and not _holds(region, *corner):
                parts.append(self._around(y[inside], x[inside], region, halo))
        return np.unique(np.concatenate(parts))

    @property
    def _whole(self) -> Region:
        return Region(0, 0, self.member.shape[1], self.member.shape[0])

    def _around(self, y: IntArray, x: IntArray, region: Region, halo: int) -> IntArray:
        """Return the clusters' pixels of a region within `halo` rows and columns of a given pixel."""
        top, left = max(y.min() - halo, region.top), max(x.min() - halo, region.left)
        below = min(y.max() + halo + 1, region.top + region.height)
        right = min(x.max() + halo + 1, region.left + region.width)
        given = np.zeros((below - top, right - left), bool)
        given[y - top, x - left] = True
        wide = ndimage.maximum_filter(given, 2 * halo + 1) & self.member[top:below, left:right]
        inside_y, inside_x = np.nonzero(wide)
        return np.asarray((inside_y + top) * self.member.shape[1] + inside_x + left, np.int64)


def _holds(region: Region, y: IntArray | int, x: IntArray | int) -> NDArray[np.bool_]:
    """Return whether pixels are in a region."""
    inside_y = (y >= region.top) & (y < region.top + region.height)
    return np.asarray(inside_y & (x >= region.left) & (x < region.left + region.width))


@dataclass(frozen=True)
class Sampled:
    """Results of a few windows of one channel.

    windows : division with the smallest halo that suits most of the sample; a block may enlarge its halo.
    seconds : core seconds of all blocks, three channels.
    entries : entries of T⁺: pixels of the clusters times the mean row length of the sample.
    failing : share of the sample that no halo brings within the tolerance.
    """

    windows: Windows
    seconds: float
    entries: float
    failing: float


def plan_windows(
    channel: WindowedChannel,
    member: NDArray[np.bool_],
    tolerance: float,
    regions: Sequence[Region] = (),
    truncation: Truncation | None = None,
) -> Sampled:
    """Plan the blocks, and measure a few of them.

    member : (projector height, projector width).
    regions : regions of several projectors.
    truncation : truncation of T⁺'s rows; None to skip the seconds and the entries, which are then 0.
    """
    side = _block_side(member, channel.camera_pixels)
    narrow = Windows(member, HALOS[0], side, tuple(regions) if len(regions) > 1 else ())
    corners = narrow.blocks()
    jobs = [partial(_sample, channel, narrow, corner, tolerance, truncation) for corner in _spread(corners)]
    samples = list(run_jobs(jobs, "sampling windows"))
    rows = np.count_nonzero(member) / sum(each.rows for each in samples)
    return Sampled(
        replace(narrow, halo=int(np.median([each.halo for each in samples]))),
        float(np.mean([each.seconds for each in samples])) * len(corners),
        rows * sum(each.entries for each in samples),
        float(np.mean([each.residual > tolerance for each in samples])),
    )


def sampled_pixels(member: NDArray[np.bool_]) -> IntArray:
    """Return the projector pixels of the widest windows that `plan_windows` samples, for the largest block size."""
    widest = Windows(member, HALOS[0], BLOCKS[0])
    return np.unique(np.concatenate([widest.pixels(each, HALOS[-1]) for each in _spread(widest.blocks())]))


@dataclass(frozen=True)
class _Sample:
    """A window's halo, residual (‖r‖₁) and core seconds with that halo; its rows and their entries."""

    halo: int
    residual: float
    seconds: float
    rows: int
    entries: int


def _sample(
    channel: WindowedChannel, windows: Windows, corner: tuple[int, int], tolerance: float, truncation: Truncation | None
) -> _Sample:
    found, halo = _grow(channel, windows, corner, tolerance)
    block, residual = windows.pixels(corner, 0), float(found.residual.max())
    if truncation is None:
        return _Sample(halo, residual, 0.0, block.size, 0)
    start = time.thread_time()
    channel.solve(block, windows.window(channel, corner, halo))
    solved = time.thread_time()
    alike = np.repeat(np.ascontiguousarray(found.columns.T)[None, None], len(CHANNELS), axis=0)
    entries = truncated_piece(block[None], found.camera[None], alike, truncation).columns.size
    seconds = len(CHANNELS) * (solved - start) + time.thread_time() - solved
    return _Sample(halo, residual, seconds, block.size, entries)


def _spread(corners: list[tuple[int, int]]) -> list[tuple[int, int]]:
    places = np.linspace(0, len(corners) - 1, SAMPLE_WINDOWS + 2).astype(int)[1:-1]
    return sorted({corners[i] for i in places})


def _block_side(member: NDArray[np.bool_], camera_pixels: int) -> int:
    """Return the largest side for which a block's rows, over all camera pixels that a window sees, fit in memory."""
    density = camera_pixels / np.count_nonzero(member)
    for side in BLOCKS:
        seen = min(density * (side + 2 * HALOS[-1]) ** 2, camera_pixels)
        if 3 * side**2 * seen <= BLOCK_VALUES:
            return side
    return BLOCKS[-1]


def _grow(
    channel: WindowedChannel, windows: Windows, corner: tuple[int, int], tolerance: float
) -> tuple[WindowRows, int]:
    """Solve the block at `corner` with the first halo whose residual is within the tolerance.

    If two halos show that even the widest will miss the tolerance by far, the second is the last: wider halos cost more
    and gain little.
    """
    block = windows.pixels(corner, 0)
    previous: tuple[int, float] | None = None
    for halo in HALOS[HALOS.index(windows.halo) :]:
        found = channel.solve(block, windows.window(channel, corner, halo))
        residual = float(found.residual.max())
        if residual <= tolerance or (previous and _hopeless(*previous, halo, residual, tolerance)):
            break
        previous = halo, residual
    return found, halo


def _hopeless(first: int, before: float, second: int, after: float, tolerance: float) -> bool:
    """Return whether a residual that keeps falling at this rate ends far above the tolerance."""
    decay = (after / before) ** (1 / (second - first))
    return bool(after * decay ** (HALOS[-1] - second) > QUICKENING * tolerance)


def windowed_jobs(
    channels: tuple[WindowedChannel, ...],
    windows: Windows,
    truncation: Truncation,
    tolerance: float,
    corners: Sequence[tuple[int, int]] | None = None,
) -> Iterator[Callable[[], Piece]]:
    """Yield jobs that invert one block of projector pixels each. corners : of the blocks; None for all blocks."""
    for corner in windows.blocks() if corners is None else corners:
        yield partial(_invert, channels, windows, corner, truncation, tolerance)


def _invert(
    channels: tuple[WindowedChannel, ...],
    windows: Windows,
    corner: tuple[int, int],
    truncation: Truncation,
    tolerance: float,
) -> Piece:
    grown = [_grow(channel, windows, corner, tolerance) for channel in channels]
    parts = [part for part, _ in grown]
    block = windows.pixels(corner, 0)
    camera = np.unique(np.concatenate([part.camera for part in parts]))
    blocks = np.zeros((len(parts), camera.size, block.size))
    for blocks_of_channel, part in zip(blocks, parts, strict=True):
        blocks_of_channel[np.searchsorted(camera, part.camera)] = part.columns
    residual = np.max([part.residual for part in parts], axis=0)
    rows = np.ascontiguousarray(blocks.transpose(0, 2, 1))
    halo = max(halo for _, halo in grown)
    return truncated_piece(block[None], camera[None], rows[:, None], truncation, residual, halo)

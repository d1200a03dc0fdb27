"""Large clusters inverted through overlapping windows of the projector picture.

Rows of a damped inverse decay: what a projector pixel needs to know lies within a few pixels around it. So each block
of pixels solves the normal equations N x = 1_i, N = TᵀT + P + λ²I, of a window, the block and a halo, and keeps the
block's rows x Tᵀ. What is left, r = N x − 1_i, lies just outside the window, and for any picture the drive differs from
that of the exact inverse by rᵀ p*, p* the exact drive (docs/mathematics.md 2). The halo grows, block by block and
channel by channel, until ‖r‖₁ is within the tolerance.

Of several projectors in one raster, a block's neighbours are also the others' pixels that light the same places.
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
QUICKENING = 30.0  # the decay quickens: residuals end up to so many times below what their first two halos foretell
FINEST_TOLERANCE = 0.05 / 255  # drive; windows are not widened for less


@dataclass(frozen=True)
class WindowRows:
    """Rows of T⁺ of one channel.

    camera : (m,) pixels, ascending.  columns : (m, block pixels), each a row of T⁺.  residual : (block pixels,) ‖r‖₁.
    """

    camera: IntArray
    columns: FloatArray
    residual: FloatArray


class WindowedChannel:
    """One colour channel of large clusters: T by columns, and N = TᵀT + P + λ²I, from which windows are cut.

    T : (camera pixels, projector pixels).  damping : λ > 0.  prior : P, (projector pixels, projector pixels).
    camera_pixels : that see the projector, if T holds not the rows of all.
    """

    def __init__(self, T: Csr, damping: float, prior: Csr | None = None, camera_pixels: int | None = None) -> None:
        wide = T.astype(np.float64)
        self.camera_pixels = int(np.count_nonzero(np.diff(T.indptr))) if camera_pixels is None else camera_pixels
        self._columns = sparse.csc_array(wide)
        normal = wide.T @ wide + damping**2 * sparse.eye_array(T.shape[1])
        self._normal = sparse.csr_array(normal if prior is None else normal + prior)

    def solve(self, block: IntArray, window: IntArray) -> WindowRows:
        """Rows `block` of T⁺ computed on `window` ⊇ block (projector pixels, both ascending)."""
        normal, outside = self._split(window)
        X = columns_of_inverse(normal, np.searchsorted(window, block))
        residual = np.abs(outside @ X).sum(axis=0)
        local = self._columns[:, window]
        camera, place = np.unique(local.indices, return_inverse=True)
        compact = sparse.csc_array((local.data, place, local.indptr), shape=(camera.size, window.size))
        return WindowRows(camera.astype(np.int64), compact @ X, residual)

    def touched(self, block: IntArray) -> IntArray:
        """Projector pixels that light what a block's pixels light, ascending."""
        return np.unique(self._normal[block].indices).astype(np.int64)

    def part(self, pixels: IntArray) -> tuple[sparse.csc_array, Csr]:
        """T's columns and N's rows and columns of some projector pixels, ascending."""
        return self._columns[:, pixels], self._normal[pixels][:, pixels]

    def _split(self, window: IntArray) -> tuple[Csr, Csr]:
        """N[window, window], and N[outside, window] with rows for those pixels only that the window touches."""
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
    """How large clusters are cut: their pixels as a picture, the blocks' side and the halo to begin with.

    regions : of several projectors in the picture; empty for one.
    """

    member: NDArray[np.bool_]
    halo: int
    block: int
    regions: tuple[Region, ...] = ()

    def blocks(self) -> list[tuple[int, int]]:
        """Upper left corners (row, column) of the blocks that hold any pixel of the clusters.

        No block reaches from one projector's region into another's.
        """
        corners = [
            (y, x)
            for left, top, width, height in self.regions or (self._whole,)
            for y in range(top, top + height, self.block)
            for x in range(left, left + width, self.block)
        ]
        return [corner for corner in corners if self.pixels(corner, 0).size]

    def pixels(self, corner: tuple[int, int], halo: int) -> IntArray:
        """Projector pixels of the clusters in the block at `corner` widened by `halo`, ascending."""
        y, x = corner
        own = next((region for region in self.regions if _holds(region, y, x)), self._whole)
        below, right = min(y + self.block, own.top + own.height), min(x + self.block, own.left + own.width)
        rows, columns = slice(max(y - halo, 0), below + halo), slice(max(x - halo, 0), right + halo)
        inside_y, inside_x = np.nonzero(self.member[rows, columns])
        return np.asarray((inside_y + rows.start) * self.member.shape[1] + inside_x + columns.start, np.int64)

    def window(self, channel: WindowedChannel, corner: tuple[int, int], halo: int) -> IntArray:
        """What a block is solved on, ascending: its own surroundings, and those of what it touches in other regions."""
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
        """The clusters' pixels of a region that are at most `halo` from one of the given, in rows and in columns."""
        top, left = max(y.min() - halo, region.top), max(x.min() - halo, region.left)
        below = min(y.max() + halo + 1, region.top + region.height)
        right = min(x.max() + halo + 1, region.left + region.width)
        given = np.zeros((below - top, right - left), bool)
        given[y - top, x - left] = True
        wide = ndimage.maximum_filter(given, 2 * halo + 1) & self.member[top:below, left:right]
        inside_y, inside_x = np.nonzero(wide)
        return np.asarray((inside_y + top) * self.member.shape[1] + inside_x + left, np.int64)


def _holds(region: Region, y: IntArray | int, x: IntArray | int) -> NDArray[np.bool_]:
    """Whether pixels are in a region."""
    inside_y = (y >= region.top) & (y < region.top + region.height)
    return np.asarray(inside_y & (x >= region.left) & (x < region.left + region.width))


@dataclass(frozen=True)
class Sampled:
    """What a few windows of one channel found.

    windows : with the smallest halo that most of them get by with; blocks grow their own.
    seconds : of a processor, that all blocks take, three channels.  entries : of T⁺, (pixels of the clusters) times the
    mean of the sample's rows.  failing : share of the sample that no halo brings within the tolerance.
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
    """Blocks, and what a few of them take and give.

    member : (projector height, projector width).  regions : of several projectors in it.
    truncation : of T⁺'s rows; None to ask for no entries.
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
    """Projector pixels of the widest windows that `plan_windows` samples where blocks are as large as they can be."""
    widest = Windows(member, HALOS[0], BLOCKS[0])
    return np.unique(np.concatenate([widest.pixels(each, HALOS[-1]) for each in _spread(widest.blocks())]))


@dataclass(frozen=True)
class _Sample:
    """A window's halo, residual (‖r‖₁), and processor seconds with that halo; rows and their entries."""

    halo: int
    residual: float
    seconds: float
    rows: int
    entries: int


def _sample(
    channel: WindowedChannel, windows: Windows, corner: tuple[int, int], tolerance: float, truncation: Truncation | None
) -> _Sample:
    found, halo = _grow(channel, windows, corner, tolerance)
    start = time.thread_time()
    block = windows.pixels(corner, 0)
    channel.solve(block, windows.window(channel, corner, halo))
    solved = time.thread_time()
    entries = 0
    if truncation is not None:
        alike = np.repeat(np.ascontiguousarray(found.columns.T)[None, None], len(CHANNELS), axis=0)
        entries = truncated_piece(block[None], found.camera[None], alike, truncation).columns.size
    seconds = len(CHANNELS) * (solved - start) + time.thread_time() - solved
    return _Sample(halo, float(found.residual.max()), seconds, block.size, entries)


def _spread(corners: list[tuple[int, int]]) -> list[tuple[int, int]]:
    places = np.linspace(0, len(corners) - 1, SAMPLE_WINDOWS + 2).astype(int)[1:-1]
    return sorted({corners[i] for i in places})


def _block_side(member: NDArray[np.bool_], camera_pixels: int) -> int:
    """The largest side whose rows, over all camera pixels that a window sees, stay within memory."""
    density = camera_pixels / np.count_nonzero(member)
    for side in BLOCKS:
        seen = min(density * (side + 2 * HALOS[-1]) ** 2, camera_pixels)
        if 3 * side**2 * seen <= BLOCK_VALUES:
            return side
    return BLOCKS[-1]


def _grow(
    channel: WindowedChannel, windows: Windows, corner: tuple[int, int], tolerance: float
) -> tuple[WindowRows, int]:
    """The block at `corner`, solved with the first halo whose residual is within the tolerance.

    Where two halos say that not even the widest will come near it, the second is the last: each further one costs more
    and gains little.
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
    """Whether a residual that falls from halo to halo as it did between two ends far above the tolerance."""
    decay = (after / before) ** (1 / (second - first))
    return bool(after * decay ** (HALOS[-1] - second) > QUICKENING * tolerance)


def windowed_jobs(
    channels: tuple[WindowedChannel, ...],
    windows: Windows,
    truncation: Truncation,
    tolerance: float,
    corners: Sequence[tuple[int, int]] | None = None,
) -> Iterator[Callable[[], Piece]]:
    """Jobs that invert one block of projector pixels each.  corners : of the blocks; None for all."""
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

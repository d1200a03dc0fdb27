"""The quad-tree of projector blocks, and light known for blocks of several sizes.

Level l cuts the projector into squares of side S / 2ˡ, where S is the least power of two that covers it. The blocks of
the last level are pixels. The right and lower edge of the projector cut blocks off, and squares outside do not exist.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from counterlight.arrays import FloatArray, IntArray
from counterlight.maps.row_map import SparseRows, below_each_other
from counterlight.tools.acquisition.plan import Pattern
from counterlight.tools.transport.transport import Csr, Dense, FarLight, Transport, stacked

Indices: TypeAlias = NDArray[np.int32] | IntArray

NO_CHILD = -1
MOST_FAR_CELLS = 1500  # a dense matrix mixes the cells of FarLight
LEAST_FAR_SIDE = 4  # side of the smallest blocks of far light, projector pixels
# rasters of more projector pixels are wide; side of the largest spread blocks of a wide raster
WIDE, WIDE_SPREAD = 1 << 18, 4
# largest number of camera pixels that see one cell of far light; a texture's row holds twice as many
MOST_READ = 1 << 13


@dataclass(frozen=True)
class BlockGrid:
    """The blocks of one level of a projector of (height, width), numbered row by row."""

    projector: tuple[int, int]
    side: int

    @property
    def rows(self) -> int:
        return -(-self.projector[0] // self.side)

    @property
    def columns(self) -> int:
        return -(-self.projector[1] // self.side)

    @property
    def count(self) -> int:
        return self.rows * self.columns

    @cached_property
    def labels(self) -> IntArray:
        """The block of each projector pixel, (height, width)."""
        height, width = self.projector
        return np.arange(height)[:, None] // self.side * self.columns + np.arange(width) // self.side

    @cached_property
    def area(self) -> IntArray:
        """Projector pixels per block."""
        sizes = [np.minimum(self.side, extent - np.arange(0, extent, self.side)) for extent in self.projector]
        return np.multiply.outer(*sizes).ravel()

    @cached_property
    def children(self) -> NDArray[np.int32]:
        """The four blocks of half the side in each block, (blocks, 4); NO_CHILD outside the projector."""
        finer = BlockGrid(self.projector, self.side // 2)
        row, column = np.divmod(np.arange(self.count)[:, None], self.columns)
        row, column = 2 * row + np.array([0, 0, 1, 1]), 2 * column + np.array([0, 1, 0, 1])
        inside = (row < finer.rows) & (column < finer.columns)
        return np.where(inside, row * finer.columns + column, NO_CHILD).astype(np.int32)

    @property
    def quarter_areas(self) -> IntArray:
        """Projector pixels in each block's quarters, (blocks, 4); 0 outside the projector."""
        area = BlockGrid(self.projector, self.side // 2).area
        return np.where(self.children != NO_CHILD, area[self.children], 0)

    def paint(self, lit: IntArray) -> Pattern:
        """Returns the pattern that lights some blocks."""
        on = np.zeros((self.rows, self.columns), np.bool_)
        on.ravel()[lit] = True
        height, width = self.projector
        across = np.repeat(on, self.side, axis=1)[:, :width]
        return np.ascontiguousarray(np.repeat(across, self.side, axis=0)[:height])


def grids(projector: tuple[int, int]) -> list[BlockGrid]:
    """Returns the levels from one block that covers the projector down to its pixels."""
    side = 1 << (max(projector) - 1).bit_length()
    return [BlockGrid(projector, side >> level) for level in range(side.bit_length())]


@dataclass(frozen=True)
class BlockLight:
    """Light from blocks of one grid to camera pixels.

    camera, block : (entries,).
    light : (entries, 3). Radiance with the whole block lit.
    """

    grid: BlockGrid
    camera: Indices
    block: Indices
    light: NDArray[np.floating]

    def select(self, which: NDArray[np.bool_] | IntArray | slice) -> "BlockLight":
        return BlockLight(self.grid, self.camera[which], self.block[which], self.light[which])

    def matrices(self, camera_pixels: int) -> tuple[Csr, ...]:
        """Returns one matrix (camera pixels, blocks) per channel."""
        shape = camera_pixels, self.grid.count
        return tuple(sparse.csr_array((self.light[:, i], (self.camera, self.block)), shape=shape) for i in range(3))


def joined(parts: Sequence[BlockLight]) -> BlockLight:
    """Concatenate light of blocks of the same grid."""
    camera, block, light = (
        np.concatenate([getattr(part, name) for part in parts]) for name in ("camera", "block", "light")
    )
    return BlockLight(parts[0].grid, camera, block, light)


def sum_by_camera(parts: Sequence[BlockLight], camera_pixels: int) -> FloatArray:
    """Returns the floodlit room that the parts add up to, (camera pixels, 3)."""
    total = np.zeros((camera_pixels, 3))
    for part in parts:
        for i in range(3):
            total[:, i] += np.bincount(part.camera, part.light[:, i], camera_pixels)
    return total


def fit_to_composition(parts: Sequence[BlockLight], composition: FloatArray) -> list[BlockLight]:
    """Scale each camera pixel's light per channel, so that it adds up to T·1, (camera pixels, 3).

    The floodlight is the capture with the least relative noise; a sum of many weak entries has the most.
    """
    total = sum_by_camera(parts, len(composition))
    scale = np.divide(np.maximum(composition, 0), total, out=np.ones_like(total), where=total > 0)
    return [BlockLight(p.grid, p.camera, p.block, p.light * scale[p.camera]) for p in parts]


def as_transport(parts: Sequence[BlockLight], camera_pixels: int) -> Transport:
    """Make T of a projector's pixels: finely measured light becomes near light, light of blocks becomes far light."""
    return with_readable_far(together([Seen.of(parts, camera_pixels)], parts[0].grid.projector))


def with_readable_far(transport: Transport) -> Transport:
    """Split cells of far light so that no row of Uᵀ is too long for a texture."""
    return transport if transport.far is None else replace(transport, far=_readable(transport.far))


@dataclass(frozen=True)
class Seen:
    """The light that some camera pixels see.

    near : light of projector pixels.
    far : light of the blocks of `_senders`, the finest first.
    """

    near: SparseRows
    far: SparseRows

    @classmethod
    def of(cls, parts: Sequence[BlockLight], camera_pixels: int) -> "Seen":
        """Divide light into near light of pixels and far light of at most 1500 blocks; smaller blocks join one of them.

        A small block is the rim of a spot if the camera pixel sees single pixels in the same cell. Unless it is too
        large, it becomes near light, spread over its pixels. Any other small block is far light that happened to be
        measurable, and joins its cell.
        """
        projector = parts[0].grid.projector
        senders = _senders(projector)
        cells = senders[0]
        fine = [part for part in parts if part.grid.side < cells.side]
        coarse = [part for part in parts if part.grid.side >= cells.side]
        spots = [_places(part, cells) for part in fine if part.grid.side == 1]
        adjacent = np.unique(np.concatenate([*spots, np.zeros(0, np.int64)]))
        near: list[BlockLight] = []
        for part in fine:
            if part.grid.side > _most_spread(projector):
                close = np.zeros(part.camera.size, np.bool_)
            else:
                close = np.isin(_places(part, cells), adjacent)
            near.append(part.select(close))
            away = part.select(~close)
            coarse.append(BlockLight(cells, away.camera, _ancestor(away, cells), away.light))
        return cls(stacked(_spread(near, camera_pixels, projector)), _sent(coarse, camera_pixels, senders))


def together(bands: Sequence[Seen], projector: tuple[int, int]) -> Transport:
    """Make T from the light of all bands."""
    far = below_each_other([band.far for band in bands])
    return Transport(
        below_each_other([band.near for band in bands]), _far_light(far, projector) if far.indices.size else None
    )


def _most_spread(projector: tuple[int, int]) -> int:
    """Returns the side of the largest blocks that are spread over their pixels; small for a wide raster."""
    return WIDE_SPREAD if is_wide(projector) else max(projector)


def is_wide(projector: tuple[int, int]) -> bool:
    """Whether the raster is so large that following each small block would take too much memory."""
    return projector[0] * projector[1] > WIDE


def _least_cell(projector: tuple[int, int]) -> int:
    """Returns the side of the smallest blocks that, with all larger blocks, are few enough for far light."""
    levels = grids(projector)
    fitting = [level.side for i, level in enumerate(levels) if sum(g.count for g in levels[: i + 1]) <= MOST_FAR_CELLS]
    return max(LEAST_FAR_SIDE, min(fitting))


def _ancestor(part: BlockLight, cells: BlockGrid) -> IntArray:
    """Returns the cell that contains each of the part's blocks."""
    row, column = np.divmod(part.block, part.grid.columns)
    scale = cells.side // part.grid.side
    return np.asarray(row // scale * cells.columns + column // scale)


def _places(part: BlockLight, cells: BlockGrid) -> IntArray:
    """Returns a unique number per pair of camera pixel and cell."""
    return part.camera * np.int64(cells.count) + _ancestor(part, cells)


def _spread(parts: Sequence[BlockLight], camera_pixels: int, projector: tuple[int, int]) -> tuple[Csr, ...]:
    pixels = projector[0] * projector[1]
    near: list[Csr] = [sparse.csr_array((camera_pixels, pixels)) for _ in range(3)]
    for part in parts:
        average = _averages(part.grid)
        near = [sparse.csr_array(T + E @ average) for T, E in zip(near, part.matrices(camera_pixels), strict=True)]
    return tuple(T.astype(np.float32) for T in near)


def _senders(projector: tuple[int, int]) -> list[BlockGrid]:
    """Returns the blocks that far light may come from, the smallest first."""
    least = _least_cell(projector)
    return [grid for grid in reversed(grids(projector)) if grid.side >= least]


def _sent(parts: Sequence[BlockLight], camera_pixels: int, senders: Sequence[BlockGrid]) -> SparseRows:
    """Returns the light of the senders' blocks, (camera pixels, all blocks)."""
    ends = np.cumsum([grid.count for grid in senders])
    first = {grid.side: int(end) - grid.count for grid, end in zip(senders, ends, strict=True)}
    columns = int(ends[-1])
    if not parts:
        return SparseRows(np.zeros(camera_pixels + 1, np.int64), np.zeros(0, np.int32), np.zeros((0, 3)), columns)
    camera, light = (np.concatenate([getattr(part, name) for part in parts]) for name in ("camera", "light"))
    place = camera * np.int64(columns) + np.concatenate([part.block + first[part.grid.side] for part in parts])
    order = np.argsort(place, kind="stable")
    place = place[order]
    once = np.flatnonzero(np.diff(place, prepend=-1))
    lengths = np.bincount(camera[order][once], minlength=camera_pixels)
    weights = np.add.reduceat(light[order], once, axis=0) if once.size else light
    indptr = np.concatenate([[0], np.cumsum(lengths)])
    return SparseRows(indptr, (place[once] % columns).astype(np.int32), weights, columns)


def _far_light(sent: SparseRows, projector: tuple[int, int]) -> FarLight:
    """Make U M D: D averages the drive over the finest blocks, M combines them to the sending blocks, U is their light.

    The first cells are the finest blocks, which only gather; then follow the senders, which only scatter.
    """
    senders = _senders(projector)
    used = np.flatnonzero(np.bincount(sent.indices, minlength=sent.columns))
    ends = np.cumsum([grid.count for grid in senders])
    finest = senders[int(np.searchsorted(ends, used[0], side="right"))]
    shares = sparse.csr_array(sparse.vstack([_cell_shares(grid, finest) for grid in senders]))
    gathering, cells = finest.count, finest.count + used.size
    mix = np.zeros((cells, cells))
    mix[gathering:, :gathering] = shares[used].toarray()
    D = sparse.csr_array(sparse.vstack([_averages(finest), sparse.csr_array((used.size, finest.labels.size))]))
    place = np.zeros(sent.columns, np.int32)
    place[used] = np.arange(gathering, cells)
    U = replace(sent, indices=place[sent.indices], columns=cells)
    return FarLight(stacked([D] * 3), Dense(np.stack([mix] * 3)), U)


def _readable(far: FarLight) -> FarLight:
    """Split each cell that more than 8192 camera pixels see, so that no row of Uᵀ is too long for a texture."""
    U = far.scatter
    order = np.argsort(U.indices, kind="stable")
    block = U.indices[order]
    rank = np.empty(block.size, np.int64)
    rank[order] = np.arange(block.size) - np.searchsorted(block, block)
    parts = np.maximum(-(-np.bincount(U.indices, minlength=U.columns) // MOST_READ), 1)
    cells = int(parts.sum())
    if cells == U.columns:
        return far
    of = np.repeat(np.arange(U.columns), parts)  # the old cell of each new cell
    place = np.concatenate([[0], np.cumsum(parts)])[U.indices] + rank // MOST_READ
    mix = np.zeros((3, cells, cells))
    first = np.flatnonzero(np.diff(of, prepend=-1))  # only scattering is split: the first new cell gathers all light
    mix[:, :, first] = far.mix.matrices[:, of]
    D = far.gather
    lengths = np.zeros(cells, np.int64)
    lengths[first] = D.lengths
    gather = replace(D, indptr=np.concatenate([[0], np.cumsum(lengths)]))
    return FarLight(gather, Dense(mix), replace(U, indices=place.astype(np.int32), columns=cells))


def _cell_shares(grid: BlockGrid, cells: BlockGrid) -> Csr:
    """Returns the share of each block that each cell covers, (blocks, cells)."""
    places = grid.labels.ravel(), cells.labels.ravel()
    return sparse.csr_array((1 / grid.area[places[0]], places), shape=(grid.count, cells.count))


def _averages(grid: BlockGrid) -> Csr:
    """Returns the matrix of the mean drive of each block, (blocks, projector pixels)."""
    labels = grid.labels.ravel()
    places = labels, np.arange(labels.size)
    return sparse.csr_array((1 / grid.area[labels], places), shape=(grid.count, labels.size))

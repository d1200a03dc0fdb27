"""The quad-tree of projector blocks, and light that is known for blocks of several sizes.

Level l cuts the projector into squares of side S / 2ˡ, S the power of two that covers it; the last level's are pixels.
Blocks at the right and lower edge are cut off by it, and squares wholly outside do not exist.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from counterlight.arrays import FloatArray, IntArray
from counterlight.tools.acquisition.plan import Pattern
from counterlight.tools.transport.transport import Csr, FarLight, Transport

Indices: TypeAlias = NDArray[np.int32] | IntArray

NO_CHILD = -1
MOST_FAR_CELLS = 1500  # FarLight mixes cells by a dense matrix
LEAST_FAR_SIDE = 4  # projector pixels
MOST_READ = 1 << 13  # camera pixels that one cell of far light is seen by; a texture's row holds twice as many


@dataclass(frozen=True)
class BlockGrid:
    """The blocks of one level, numbered row by row.  projector : (height, width)."""

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
        """The block of each projector pixel: (height, width)."""
        height, width = self.projector
        return np.arange(height)[:, None] // self.side * self.columns + np.arange(width) // self.side

    @cached_property
    def area(self) -> IntArray:
        """Projector pixels in each block."""
        sizes = [np.minimum(self.side, extent - np.arange(0, extent, self.side)) for extent in self.projector]
        return np.multiply.outer(*sizes).ravel()

    @cached_property
    def children(self) -> NDArray[np.int32]:
        """The four blocks of half the side in each: (blocks, 4), NO_CHILD where the projector ends before."""
        finer = BlockGrid(self.projector, self.side // 2)
        row, column = np.divmod(np.arange(self.count)[:, None], self.columns)
        row, column = 2 * row + np.array([0, 0, 1, 1]), 2 * column + np.array([0, 1, 0, 1])
        inside = (row < finer.rows) & (column < finer.columns)
        return np.where(inside, row * finer.columns + column, NO_CHILD).astype(np.int32)

    def paint(self, lit: IntArray) -> Pattern:
        """The picture in which some blocks are lit."""
        on = np.zeros((self.rows, self.columns), np.bool_)
        on.ravel()[lit] = True
        height, width = self.projector
        across = np.repeat(on, self.side, axis=1)[:, :width]
        return np.ascontiguousarray(np.repeat(across, self.side, axis=0)[:height])


def grids(projector: tuple[int, int]) -> list[BlockGrid]:
    """From one block that covers the projector down to its pixels."""
    side = 1 << (max(projector) - 1).bit_length()
    return [BlockGrid(projector, side >> level) for level in range(side.bit_length())]


@dataclass(frozen=True)
class BlockLight:
    """Light from blocks of one grid to camera pixels.

    camera, block : (entries,).  light : (entries, 3), radiance with the whole block lit.
    """

    grid: BlockGrid
    camera: Indices
    block: Indices
    light: NDArray[np.floating]

    def select(self, which: NDArray[np.bool_] | IntArray | slice) -> "BlockLight":
        return BlockLight(self.grid, self.camera[which], self.block[which], self.light[which])

    def matrices(self, camera_pixels: int) -> tuple[Csr, ...]:
        """(camera pixels, blocks) per channel."""
        shape = camera_pixels, self.grid.count
        return tuple(sparse.csr_array((self.light[:, i], (self.camera, self.block)), shape=shape) for i in range(3))


def joined(parts: Sequence[BlockLight]) -> BlockLight:
    """Light of blocks of one grid, one part after the other."""
    camera, block, light = (
        np.concatenate([getattr(part, name) for part in parts]) for name in ("camera", "block", "light")
    )
    return BlockLight(parts[0].grid, camera, block, light)


def sum_by_camera(parts: Sequence[BlockLight], camera_pixels: int) -> FloatArray:
    """The floodlit room that the parts add up to: (camera pixels, 3)."""
    total = np.zeros((camera_pixels, 3))
    for part in parts:
        for i in range(3):
            total[:, i] += np.bincount(part.camera, part.light[:, i], camera_pixels)
    return total


def fit_to_composition(parts: Sequence[BlockLight], composition: FloatArray) -> list[BlockLight]:
    """Scale each camera pixel's light so that it adds up to T·1, (camera pixels, 3); channel by channel.

    The floodlight is the capture with the least relative noise, a sum of many weak entries the one with the most.
    """
    total = sum_by_camera(parts, len(composition))
    scale = np.divide(np.maximum(composition, 0), total, out=np.ones_like(total), where=total > 0)
    return [BlockLight(p.grid, p.camera, p.block, p.light * scale[p.camera]) for p in parts]


def as_transport(parts: Sequence[BlockLight], camera_pixels: int) -> Transport:
    """T of a projector's pixels: light measured finely as near light, light known for blocks only as far light.

    There are at most 1500 such blocks, so smaller ones than some side have none of their own. Where the camera pixel
    sees single pixels of the same cell, such a block is the rim of a spot and becomes near light, spread over its
    pixels; elsewhere it is far light that happened to be measurable, and goes to its cell.
    """
    projector = parts[0].grid.projector
    least = _least_cell(projector)
    fine = [part for part in parts if part.grid.side < least]
    coarse = [part for part in parts if part.grid.side >= least]
    cells = BlockGrid(projector, least)
    spots = [_places(part, cells) for part in fine if part.grid.side == 1]
    beside = np.unique(np.concatenate([*spots, np.zeros(0, np.int64)]))
    near: list[BlockLight] = []
    for part in fine:
        close = np.isin(_places(part, cells), beside)
        near.append(part.select(close))
        away = part.select(~close)
        coarse.append(BlockLight(cells, away.camera, _ancestor(away, cells), away.light))
    coarse = [part for part in coarse if part.camera.size]
    far = _far_light(coarse, camera_pixels) if coarse else None
    return Transport.from_matrices(_spread(near, camera_pixels, projector), far)


def _least_cell(projector: tuple[int, int]) -> int:
    """The side of the smallest blocks that, with all larger ones, are few enough for far light."""
    levels = grids(projector)
    fitting = [level.side for i, level in enumerate(levels) if sum(g.count for g in levels[: i + 1]) <= MOST_FAR_CELLS]
    return max(LEAST_FAR_SIDE, min(fitting))


def _ancestor(part: BlockLight, cells: BlockGrid) -> IntArray:
    """The cell that holds each of the part's blocks."""
    row, column = np.divmod(part.block, part.grid.columns)
    scale = cells.side // part.grid.side
    return np.asarray(row // scale * cells.columns + column // scale)


def _places(part: BlockLight, cells: BlockGrid) -> IntArray:
    """A number for each camera pixel and cell."""
    return part.camera * np.int64(cells.count) + _ancestor(part, cells)


def _spread(parts: Sequence[BlockLight], camera_pixels: int, projector: tuple[int, int]) -> tuple[Csr, ...]:
    pixels = projector[0] * projector[1]
    near: list[Csr] = [sparse.csr_array((camera_pixels, pixels)) for _ in range(3)]
    for part in parts:
        average = _averages(part.grid)
        near = [sparse.csr_array(T + E @ average) for T, E in zip(near, part.matrices(camera_pixels), strict=True)]
    return tuple(T.astype(np.float32) for T in near)


def _far_light(parts: Sequence[BlockLight], camera_pixels: int) -> FarLight:
    """U M D: D averages the drive over the finest blocks, M makes of them the blocks that send, U is what each sends.

    Cells are the finest blocks first, which only gather, and then the senders, which only scatter. A block that more
    than 8192 camera pixels see becomes several senders, so that no row of Uᵀ is too long for a texture.
    """
    finest = min((part.grid for part in parts), key=lambda grid: grid.side)
    sizes = sorted({part.grid for part in parts}, key=lambda grid: grid.side)
    first = dict(zip(sizes, np.cumsum([0, *(grid.count for grid in sizes)]), strict=False))
    shares = sparse.csr_array(sparse.vstack([_cell_shares(grid, finest) for grid in sizes]))
    camera, light = (np.concatenate([getattr(part, name) for part in parts]) for name in ("camera", "light"))
    block = np.concatenate([part.block + first[part.grid] for part in parts])
    order = np.lexsort((camera, block))
    camera, block, light = camera[order], block[order], light[order]
    rank = np.arange(block.size) - np.searchsorted(block, block)
    senders, sender = np.unique(np.stack([block, rank // MOST_READ]), axis=1, return_inverse=True)
    gathering, cells = finest.count, finest.count + senders.shape[1]
    mix = np.zeros((cells, cells))
    mix[gathering:, :gathering] = shares[senders[0]].toarray()
    D = sparse.csr_array(sparse.vstack([_averages(finest), sparse.csr_array((senders.shape[1], finest.labels.size))]))
    places = camera, gathering + sender.ravel()
    U = tuple(sparse.csr_array((light[:, i], places), shape=(camera_pixels, cells)) for i in range(3))
    return FarLight.from_matrices([D] * 3, np.stack([mix] * 3), U)


def _cell_shares(grid: BlockGrid, cells: BlockGrid) -> Csr:
    """(blocks, cells): the part of each block that each cell is."""
    places = grid.labels.ravel(), cells.labels.ravel()
    return sparse.csr_array((1 / grid.area[places[0]], places), shape=(grid.count, cells.count))


def _averages(grid: BlockGrid) -> Csr:
    """(blocks, projector pixels): the mean drive of each block."""
    labels = grid.labels.ravel()
    places = labels, np.arange(labels.size)
    return sparse.csr_array((1 / grid.area[labels], places), shape=(grid.count, labels.size))

"""Represent each row of T by entries and cells, its own pruned tree of blocks (Chou, Lookabaugh and Gray 1989).

A block of 2^l × 2^l projector pixels becomes one cell with evenly spread light if that costs less than its four parts.
A cell or an entry costs λ, plus the cell's error Σ (T_ij − mean)² over its pixels and channels. No other choice of
blocks has smaller errors for as many numbers. λ = limit² · |row's light|², so that a surface's colour does not matter.
The light of a row and of each cell is unchanged. In T = S + B P, P computes the cells: means of the projector picture
over blocks of 2×2 to 16×16 pixels.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import BoolArray, IntArray
from counterlight.maps.products import compiled, kept
from counterlight.maps.row_map import SparseRows
from counterlight.tools.transport.transport import BlurredLight

LEVELS = 4  # number of sizes of cells; the largest have 16×16 pixels
COARSEST = 1 << LEVELS
LEAST_LIMIT = 1e-12  # least limit; it is positive, so that every lit entry has a cost
MANY = 1 << 16  # entries from which all cores are used


@dataclass(frozen=True)
class Pyramid:
    """Cells of a raster (height, width): whole blocks of 2×2 pixels row by row, then blocks of 4×4, and so on."""

    raster: tuple[int, int]

    @property
    def sizes(self) -> list[tuple[int, int]]:
        """(height, width) of each level, in cells."""
        height, width = self.raster
        return [(height >> level, width >> level) for level in range(1, LEVELS + 1)]

    @property
    def starts(self) -> IntArray:
        """The first cell of each level, followed by the total."""
        return np.cumsum([0, *(height * width for height, width in self.sizes)])

    @property
    def cells(self) -> int:
        return int(self.starts[-1])

    def means(self, used: BoolArray) -> SparseRows:
        """Return P, float32; rows of unused cells are empty. used : (cells,) bool. Cells that some row uses."""
        indices = [np.zeros((0,), np.int32)]
        lengths = np.zeros(self.cells, np.int64)
        for level, (start, (height, width)) in enumerate(zip(self.starts, self.sizes, strict=False), 1):
            y, x = np.divmod(np.flatnonzero(used[start : start + height * width]), max(width, 1))
            down, right = np.divmod(np.arange(1 << 2 * level), 1 << level)
            corners = (y << level) * self.raster[1] + (x << level)
            indices.append((corners[:, None] + down * self.raster[1] + right).astype(np.int32).ravel())
            lengths[start : start + height * width] = (1 << 2 * level) * used[start : start + height * width]
        weights = np.repeat((1 / np.maximum(lengths, 1)).astype(np.float32), lengths)
        pixels = self.raster[0] * self.raster[1]
        starts = np.concatenate([[0], np.cumsum(lengths)])
        return SparseRows(starts, np.concatenate(indices), np.repeat(weights[:, None], 3, axis=1), pixels)

    def light(self, scatter: SparseRows) -> BlurredLight:
        """Return B P."""
        used = np.zeros(self.cells, bool)
        used[scatter.indices] = True
        return BlurredLight(self.means(used), None, scatter)


def in_cells(rows: SparseRows, raster: tuple[int, int], limit: float) -> tuple[SparseRows, SparseRows]:
    """Returns S and B, float32, with ascending columns in each row, of some rows of T.

    raster : (height, width) of the projector.
    limit : allowed error as a share of the row's light.
    """
    pyramid = Pyramid(raster)
    levels = np.array([raster, *pyramid.sizes], np.int64)
    starts = np.append([0], pyramid.starts[:-1] + rows.columns)
    count, weights = np.zeros(rows.shape[0], np.int64), rows.weights.astype(np.float32)
    indptr, indices = rows.indptr.astype(np.int64), rows.indices.astype(np.int64)
    placed, light = np.empty(indices.size, np.int64), np.empty((indices.size, 3), np.float32)
    pruned: Callable[..., None] = _PRUNED[indices.size >= MANY]
    pruned(indptr, indices, weights, levels, starts, limit, count, placed, light)
    at = np.repeat(indptr[:-1] - np.concatenate([[0], np.cumsum(count)[:-1]]), count) + np.arange(count.sum())
    of_row, placed, light = np.repeat(np.arange(count.size), count), placed[at], light[at]
    order = np.lexsort((placed, of_row))
    fine = placed[order] < rows.columns
    near, wide = order[fine], order[~fine]
    return (
        _rows(of_row[near], placed[near], light[near], (count.size, rows.columns)),
        _rows(of_row[wide], placed[wide] - rows.columns, light[wide], (count.size, pyramid.cells)),
    )


def _rows(row: IntArray, column: IntArray, weights: NDArray[np.float32], shape: tuple[int, int]) -> SparseRows:
    starts = np.concatenate([[0], np.cumsum(np.bincount(row, minlength=shape[0]))])
    return SparseRows(starts, column.astype(np.int32), weights, shape[1])


def _pruned(indptr, indices, weights, levels, starts, limit, count, placed, given):  # type: ignore[no-untyped-def]
    """Write each row's entries and cells into the space of its old entries, which always suffices.

    levels : (height, width) of each level, pixels first.
    starts : first number of each level.
    count, placed, given : (rows,), (entries,) and (entries, 3). The output.
    """
    width = levels[0, 1]
    for row in numba.prange(indptr.size - 1):
        first, last = indptr[row], indptr[row + 1]
        light = np.zeros((LEVELS + 1, COARSEST, COARSEST, 3))
        error, cost = np.zeros((LEVELS + 1, COARSEST, COARSEST)), np.zeros((LEVELS + 1, COARSEST, COARSEST))
        single, squared = np.zeros((LEVELS + 1, COARSEST, COARSEST), np.bool_), 0.0
        for c in range(3):
            total = 0.0
            for k in range(first, last):
                total += weights[k, c]
            squared += total * total
        rent = max(limit, LEAST_LIMIT) ** 2 * squared
        blocks = np.empty(last - first, np.int64)
        for k in range(blocks.size):
            y, x = indices[first + k] // width, indices[first + k] % width
            blocks[k] = (y >> LEVELS) * width + (x >> LEVELS)
        order, begin, found = np.argsort(blocks), 0, 0
        while begin < order.size:
            block = blocks[order[begin]]
            top, left = (block // width) << LEVELS, (block % width) << LEVELS
            for i in range(COARSEST):
                for j in range(COARSEST):
                    cost[0, i, j] = 0.0
                    for c in range(3):
                        light[0, i, j, c] = 0.0
            end = begin
            while end < order.size and blocks[order[end]] == block:
                k = first + order[end]
                i, j = indices[k] // width - top, indices[k] % width - left
                for c in range(3):
                    light[0, i, j, c] = weights[k, c]
                    if weights[k, c] != 0:
                        cost[0, i, j] = rent
                end += 1
            for level in range(1, LEVELS + 1):
                whole = levels[level, 0] - (top >> level), levels[level, 1] - (left >> level)
                _grow(light, error, cost, single, level, whole, rent)
            corner = first + found
            found += _collect(light, cost, single, (top, left), levels, starts, placed[corner:], given[corner:])
            begin = end
        count[row] = found


@kept()
def _grow(light, error, cost, single, level, whole, rent):  # type: ignore[no-untyped-def]
    """Compute a level's blocks from the level below: light, error, least cost, and whether each is one cell.

    whole : blocks down and across that the raster's edge does not cut.
    """
    area, side = 4.0 ** (level - 1), COARSEST >> level
    below, errors, costs = light[level - 1], error[level - 1], cost[level - 1]
    for i in range(side):
        for j in range(side):
            y, x = 2 * i, 2 * j
            parts = costs[y, x] + costs[y + 1, x] + costs[y, x + 1] + costs[y + 1, x + 1]
            erred = errors[y, x] + errors[y + 1, x] + errors[y, x + 1] + errors[y + 1, x + 1]
            for c in range(3):
                quarter = (below[y, x, c] + below[y + 1, x, c] + below[y, x + 1, c] + below[y + 1, x + 1, c]) / 4
                for k in range(4):
                    erred += (below[y + k // 2, x + k % 2, c] - quarter) ** 2 / area
                light[level, i, j, c] = 4 * quarter
            error[level, i, j] = erred
            single[level, i, j] = i < whole[0] and j < whole[1] and erred + rent < parts
            cost[level, i, j] = erred + rent if single[level, i, j] else parts


@kept()
def _collect(light, cost, single, corner, levels, starts, placed, given):  # type: ignore[no-untyped-def]
    """Write numbers and light of the entries and cells of a coarsest block's tree; returns how many."""
    stack, waiting, found = np.empty((3 * LEVELS + 1, 3), np.int64), 1, 0
    stack[0, 0], stack[0, 1], stack[0, 2] = LEVELS, 0, 0
    while waiting:
        waiting -= 1
        level, y, x = stack[waiting, 0], stack[waiting, 1], stack[waiting, 2]
        if cost[level, y, x] == 0:
            continue
        if level == 0 or single[level, y, x]:
            placed[found] = starts[level] + ((corner[0] >> level) + y) * levels[level, 1] + (corner[1] >> level) + x
            for c in range(3):
                given[found, c] = light[level, y, x, c]
            found += 1
            continue
        for k in range(4):
            below = stack[waiting + k]
            below[0], below[1], below[2] = level - 1, 2 * y + k // 2, 2 * x + k % 2
        waiting += 4
    return found


_PRUNED = compiled(_pruned)

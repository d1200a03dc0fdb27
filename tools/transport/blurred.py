"""Blurred light: light far out of focus is smooth, so its rows address blocks of projector pixels instead of pixels.

T = S + B P + U M D. P computes the means of the projector picture over blocks of 2×2 to 16×16 pixels, the coarser
levels of its pyramid; B is sparse over these cells. A row of T may have both cells and entries of S. tools/blurring
makes such rows from full ones (docs/mathematics.md 4).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import BoolArray, FloatArray, IntArray, brief
from counterlight.maps.row_map import SparseRows

LEVELS = 4  # of cells; the coarsest have 16×16 pixels


@dataclass(frozen=True)
class BlurredLight:
    """camera radiance = scatter · gather · p, per colour channel.

    gather : P, (cells, projector pixels). Means over blocks.
    scatter : B, (camera pixels, cells). Radiance per mean.
    """

    gather: SparseRows
    scatter: SparseRows

    __repr__ = brief

    @cached_property
    def transposed(self) -> "BlurredLight":
        """Pᵀ Bᵀ."""
        return BlurredLight(self.scatter.transposed, self.gather.transposed)

    def apply(self, p: NDArray[np.floating]) -> FloatArray:
        """Return B P p: (projector pixels, 3) -> (camera pixels, 3)."""
        return self.scatter.apply(self.gather.apply(p))

    def apply_transpose(self, c: NDArray[np.floating]) -> FloatArray:
        """Multiply by the transpose: (camera pixels, 3) -> (projector pixels, 3)."""
        return self.transposed.apply(c)


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
        """Return P, float32; rows of unused cells are empty. used : (cells,) bool."""
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
        return BlurredLight(self.means(used), scatter)

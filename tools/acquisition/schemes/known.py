"""Settled light of blocks of any size, and compiled code that reads a capture above it."""

from dataclasses import dataclass, replace

import numba
import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import BoolArray, FloatArray, IntArray
from counterlight.maps.products import compiled
from counterlight.maps.row_map import SparseRows, next_to_each_other
from counterlight.tools.acquisition.plan import Noise, Pattern
from counterlight.tools.acquisition.schemes.blocks import BlockGrid, BlockLight, grids

MANY = 1 << 14  # entries from which all cores are used


@dataclass(frozen=True)
class Quarter:
    """One quarter of some blocks that a picture lights, and the arrays that receive its readings.

    entries : indices into `camera` that see the quarter.
    light, variance : (parents, 3) float32.
    lit : (parents,) bool. Whether the quarter is measurable.
    """

    camera: NDArray[np.integer]
    entries: NDArray[np.integer]
    light: NDArray[np.float32]
    variance: NDArray[np.float32]
    lit: BoolArray


class KnownLight:
    """Settled light, which is subtracted from captures.

    Columns are the blocks of all sizes, the largest first.
    """

    def __init__(self, camera_pixels: int, projector: tuple[int, int]) -> None:
        self._grids = grids(projector)
        ends = np.cumsum([grid.count for grid in self._grids])
        self._starts = {grid.side: int(end) - grid.count for grid, end in zip(self._grids, ends, strict=True)}
        none = np.zeros(camera_pixels + 1, np.int64), np.zeros(0, np.int32), np.zeros((0, 3), np.float32)
        self._rows = SparseRows(*none, int(ends[-1]))

    def add(self, part: BlockLight) -> None:
        """Add light whose camera pixels are in ascending order."""
        if not part.camera.size:
            return
        counts = np.bincount(part.camera, minlength=self._rows.shape[0])
        indices = (part.block + self._starts[part.grid.side]).astype(np.int32)
        light = part.light.astype(np.float32, copy=False)
        rows = SparseRows(np.concatenate([[0], np.cumsum(counts)]), indices, light, self._rows.columns)
        # the columns of both matrices are the same
        self._rows = next_to_each_other(replace(self._rows, columns=0), rows)

    def seen(self, pattern: Pattern) -> FloatArray:
        """Returns the settled light in the capture of a pattern, (camera pixels, 3)."""
        shares = self.shares(self._grids[-1], np.flatnonzero(pattern))
        return self._rows.apply(np.repeat(shares[:, None], 3, axis=1))

    def read(
        self,
        shares: FloatArray,
        capture: NDArray[np.floating],
        black: FloatArray,
        noise: Noise,
        least: Noise,
        to: Quarter,
    ) -> None:
        """Write the light of a capture above black and settled light into `to`.

        shares : share of each column's block that the pattern lights.
        capture, black : (camera pixels, 3).
        noise : noise of a capture.
        least : τ as a noise.
        """
        rows, limits = self._rows, np.stack([noise.dark**2, noise.gain, least.dark**2, least.gain])
        _READ[to.entries.size >= MANY](
            rows.indptr,
            rows.indices,
            rows.weights,
            shares,
            capture,
            black,
            limits,
            to.camera,
            to.entries,
            to.light,
            to.variance,
            to.lit,
        )

    def shares(self, grid: BlockGrid, lit: IntArray) -> FloatArray:
        """Returns the lit share of each column's block, (columns,), for lit blocks of a grid; 0 for smaller blocks."""
        shares = np.zeros(self._rows.columns)
        on = np.zeros(grid.count, np.int64)
        on[lit] = grid.area[lit]
        counts: IntArray = on.reshape(grid.rows, grid.columns)
        for each in reversed(self._grids[: self._grids.index(grid) + 1]):
            start = self._starts[each.side]
            np.divide(counts.ravel(), each.area, out=shares[start : start + each.count])
            padded = np.pad(counts, [(0, size % 2) for size in counts.shape])
            pairs = padded[0::2] + padded[1::2]
            counts = pairs[:, 0::2] + pairs[:, 1::2]
        return shares


def _read(
    indptr: NDArray[np.integer],
    indices: NDArray[np.integer],
    weights: NDArray[np.floating],
    share: FloatArray,
    capture: NDArray[np.floating],
    black: FloatArray,
    limits: FloatArray,
    camera: NDArray[np.integer],
    entries: NDArray[np.integer],
    light: NDArray[np.float32],
    variance: NDArray[np.float32],
    lit: BoolArray,
) -> None:
    """Read entries; `limits` is (4, 3): dark² and gain of the noise, and of τ."""
    for n in numba.prange(entries.size):
        entry = entries[n]
        pixel, bright = camera[entry], False
        red = green = blue = 0.0  # one lookup of each block's share serves all channels
        for k in range(indptr[pixel], indptr[pixel + 1]):
            part = share[indices[k]]
            if part != 0:
                red += weights[k, 0] * part
                green += weights[k, 1] * part
                blue += weights[k, 2] * part
        for c in range(3):
            background = red if c == 0 else green if c == 1 else blue
            found = capture[pixel, c] - black[pixel, c] - background
            light[entry, c] = found
            variance[entry, c] = limits[0, c] + limits[1, c] * (max(found, 0.0) + background)
            bright = bright or found >= np.sqrt(limits[2, c] + limits[3, c] * background)
        lit[entry] = bright


_READ = compiled(_read)

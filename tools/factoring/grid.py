"""Nodes over a picture, between which far light is interpolated linearly in both directions."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from counterlight.arrays import FloatArray
from counterlight.maps.row_map import SparseRows
from counterlight.tools.transport.transport import Csr, Shape


@dataclass(frozen=True)
class Grid:
    """Φ, (pixels, nodes): each pixel lies between four nodes; beyond the outer ones, it has what they have.

    nodes : rows and columns of them.  corners : (pixels, 4) int32.  weights : (pixels, 4), ≥ 0, which sum to 1.
    """

    nodes: Shape
    corners: NDArray[np.int32]
    weights: FloatArray

    @classmethod
    def over(cls, picture: Shape, count: int) -> "Grid":
        """About `count` nodes as far apart down as across, at most one for two pixels of a side.

        picture : (height, width).
        """
        apart = max(2.0, np.sqrt(picture[0] * picture[1] / count))
        rows, columns = (max(1, round(side / apart)) for side in picture)
        (top, bottom, y), (left, right, x) = (_between(*each) for each in zip(picture, (rows, columns), strict=True))
        above, below = columns * top[:, None], columns * bottom[:, None]
        corners = np.stack([above + left, above + right, below + left, below + right], axis=-1)
        down = y[:, None]
        weights = np.stack([(1 - down) * (1 - x), (1 - down) * x, down * (1 - x), down * x], axis=-1)
        return cls((rows, columns), corners.reshape(-1, 4).astype(np.int32), weights.reshape(-1, 4))

    @property
    def count(self) -> int:
        return self.nodes[0] * self.nodes[1]

    def textured(self, texture: FloatArray) -> Csr:
        """diag(texture) Φ without zeros; texture : (pixels,)."""
        pixels = len(self.corners)
        places = self.corners.ravel(), 4 * np.arange(pixels + 1)
        matrix = sparse.csr_array(((self.weights * texture[:, None]).ravel(), *places), shape=(pixels, self.count))
        matrix.sum_duplicates()
        matrix.eliminate_zeros()
        return matrix

    def rows(self, textures: FloatArray, columns: int) -> SparseRows:
        """The same of three channels; textures : (pixels, 3).  columns : as many as nodes or more, the rest empty."""
        weights = (self.weights[:, :, None] * textures[:, None]).reshape(-1, 3)
        places = 4 * np.arange(len(self.corners) + 1)
        return SparseRows(places, self.corners.ravel(), weights, columns).where((weights != 0).any(axis=1))


def _between(pixels: int, nodes: int) -> tuple[NDArray[np.int64], NDArray[np.int64], FloatArray]:
    """Of each pixel of a side the node before it, the one after, and how far it is from the first to the second."""
    at = np.clip((np.arange(pixels) + 0.5) / pixels * nodes - 0.5, 0, nodes - 1)
    before = np.minimum(at.astype(np.int64), max(nodes - 2, 0))
    return before, np.minimum(before + 1, nodes - 1), at - before

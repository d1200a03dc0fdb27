"""Nodes over a picture, between which far light is interpolated bilinearly."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from counterlight.arrays import FloatArray
from counterlight.maps.row_map import SparseRows
from counterlight.tools.transport.transport import Csr, Shape


@dataclass(frozen=True)
class Grid:
    """Φ, (pixels, nodes): interpolates each pixel between four nodes; clamped beyond the outer nodes.

    nodes : rows and columns of nodes.
    corners : (pixels, 4) int32. The nodes of each pixel.
    weights : (pixels, 4). ≥ 0, with sum 1.
    """

    nodes: Shape
    corners: NDArray[np.int32]
    weights: FloatArray

    @classmethod
    def over(cls, picture: Shape, count: int) -> "Grid":
        """Make about `count` nodes at equal distances down and across, at most one per two pixels of a side.

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
        """Returns diag(texture) Φ without zeros; texture is (pixels,)."""
        pixels = len(self.corners)
        places = self.corners.ravel(), 4 * np.arange(pixels + 1)
        matrix = sparse.csr_array(((self.weights * texture[:, None]).ravel(), *places), shape=(pixels, self.count))
        matrix.sum_duplicates()
        matrix.eliminate_zeros()
        return matrix

    def rows(self, textures: FloatArray, columns: int) -> SparseRows:
        """Returns diag(texture) Φ of three channels, padded to `columns` columns; textures is (pixels, 3)."""
        weights = (self.weights[:, :, None] * textures[:, None]).reshape(-1, 3)
        places = 4 * np.arange(len(self.corners) + 1)
        return SparseRows(places, self.corners.ravel(), weights, columns).where((weights != 0).any(axis=1))


def _between(pixels: int, nodes: int) -> tuple[NDArray[np.int64], NDArray[np.int64], FloatArray]:
    """Returns the nodes before and after each pixel of a side, and the pixel's position between them, 0 to 1."""
    at = np.clip((np.arange(pixels) + 0.5) / pixels * nodes - 0.5, 0, nodes - 1)
    before = np.minimum(at.astype(np.int64), max(nodes - 2, 0))
    return before, np.minimum(before + 1, nodes - 1), at - before

"""T by devices of fewer pixels: a camera's are means of its own, a projector's light all that they stand for."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from counterlight.arrays import FloatArray
from counterlight.maps.row_map import SparseRows
from counterlight.tools.transport.transport import Csr, Shape, Transport, channels, stacked


@dataclass(frozen=True)
class Blocks:
    """Square blocks of `factor` pixels a side; the last of a row or column takes what is left over.

    shape : (height, width) of the pixels.
    """

    shape: Shape
    factor: int

    @property
    def coarse(self) -> Shape:
        return max(1, self.shape[0] // self.factor), max(1, self.shape[1] // self.factor)

    @cached_property
    def of_pixel(self) -> NDArray[np.int64]:
        """The block that each pixel is in."""
        row, column = (
            np.minimum(np.arange(size) // self.factor, count - 1)
            for size, count in zip(self.shape, self.coarse, strict=True)
        )
        return (row[:, None] * self.coarse[1] + column).ravel()

    @cached_property
    def sums(self) -> Csr:
        """(blocks, pixels)."""
        count = self.of_pixel.size
        shape = self.coarse[0] * self.coarse[1], count
        return Csr((np.ones(count, np.float32), (self.of_pixel, np.arange(count))), shape=shape)

    @cached_property
    def means(self) -> Csr:
        """(blocks, pixels), rows that add up to 1."""
        return Csr(sparse.diags_array((1 / self.sums.sum(axis=1)).astype(np.float32)) @ self.sums)

    def mean(self, picture: NDArray[np.generic]) -> FloatArray:
        """(height, width, …) in blocks."""
        flat = np.asarray(picture, np.float64).reshape(self.of_pixel.size, -1)
        return np.asarray(self.means @ flat).reshape(*self.coarse, *picture.shape[2:])

    def spread(self, blocks: FloatArray) -> FloatArray:
        """(blocks, …) -> (pixels, …), each pixel what its block is."""
        return blocks[self.of_pixel]


def coarser(transport: Transport, camera: Blocks, projector: Blocks) -> Transport:
    """A T E: A means of camera pixels, E what a coarse projector pixel lights."""
    far = transport.far
    return Transport(
        _between(camera, transport.near, projector),
        far
        and replace(
            far,
            gather=stacked([Csr(D @ projector.sums.T) for D in channels(far.gather)]),
            scatter=stacked([Csr(camera.means @ U) for U in channels(far.scatter)]),
        ),
        camera.coarse,
        projector.coarse,
    )


def _between(camera: Blocks, near: SparseRows, projector: Blocks) -> SparseRows:
    rows = stacked([Csr(camera.means @ T @ projector.sums.T) for T in channels(near)])
    return replace(rows, weights=rows.weights.astype(np.float32))

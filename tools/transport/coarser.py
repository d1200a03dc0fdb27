"""T for devices with fewer pixels: coarse camera pixels are means, coarse projector pixels light all they contain."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from counterlight.arrays import FloatArray
from counterlight.maps.row_map import SparseRows
from counterlight.raster import Shapes, side_by_side
from counterlight.screen import parts_of, raster_of
from counterlight.tools.transport.transport import Csr, Shape, Transport, channels, stacked


class Layout(NamedTuple):
    """A raster: (height, width), and the rows and columns of each device's picture in it."""

    shape: Shape
    parts: tuple[tuple[slice, slice], ...]


def beside(projectors: Shapes) -> Layout:
    """Return the layout of projectors, side by side."""
    shape, regions = side_by_side(projectors)
    return Layout(shape, tuple(region.part for region in regions))


def below(cameras: Shapes) -> Layout:
    """Return the layout of cameras, below each other."""
    return Layout(raster_of(cameras), parts_of(cameras))


@dataclass(frozen=True)
class Blocks:
    """Square blocks of `factor` pixels a side; the last block of a row or column includes the remainder.

    shapes : (height, width) of each device.
    factor : pixels per side.
    layout : arranges the devices, each with its own blocks, in a raster; other raster pixels are ignored.
    """

    shapes: Shapes
    factor: int
    layout: Callable[[Shapes], Layout] = beside

    @property
    def coarser(self) -> Shapes:
        """(height, width) of each device, in blocks."""
        return tuple((max(1, height // self.factor), max(1, width // self.factor)) for height, width in self.shapes)

    @property
    def coarse(self) -> Shape:
        """(height, width) of the raster of blocks."""
        return self.layout(self.coarser).shape

    @cached_property
    def of_pixel(self) -> NDArray[np.int64]:
        """The block of each raster pixel, (pixels,); -1 outside the devices."""
        (shape, parts), (small, places) = self.layout(self.shapes), self.layout(self.coarser)
        blocks, numbers = np.full(shape, -1), np.arange(small[0] * small[1]).reshape(small)
        for part, place in zip(parts, places, strict=True):
            own = numbers[place]
            rows, columns = (
                np.minimum(np.arange(size) // self.factor, count - 1)
                for size, count in zip(blocks[part].shape, own.shape, strict=True)
            )
            blocks[part] = own[np.ix_(rows, columns)]
        return blocks.ravel()

    @cached_property
    def sums(self) -> Csr:
        """Matrix of block sums, (blocks, pixels)."""
        inside = np.flatnonzero(self.of_pixel >= 0)
        shape = self.coarse[0] * self.coarse[1], self.of_pixel.size
        return Csr((np.ones(inside.size, np.float32), (self.of_pixel[inside], inside)), shape=shape)

    @cached_property
    def means(self) -> Csr:
        """Matrix of block means, (blocks, pixels): rows add up to 1, or to 0 outside the devices."""
        pixels = np.maximum(self.sums.sum(axis=1), 1)
        return Csr(sparse.diags_array((1 / pixels).astype(np.float32)) @ self.sums)

    def mean(self, picture: NDArray[np.generic]) -> FloatArray:
        """Return the means of a picture (height, width, …) in blocks."""
        flat = np.asarray(picture, np.float64).reshape(self.of_pixel.size, -1)
        return np.asarray(self.means @ flat).reshape(*self.coarse, *picture.shape[2:])

    def whole(self, mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return the blocks whose pixels are all in a mask (height, width)."""
        pixels, inside = self.sums.sum(axis=1), self.sums @ mask.ravel().astype(np.float32)
        return np.asarray((pixels > 0) & (inside == pixels)).reshape(self.coarse)

    def spread(self, blocks: FloatArray) -> FloatArray:
        """Copy each block's value to its pixels, (blocks, …) -> (pixels, …); 0 outside the devices."""
        return np.where((self.of_pixel >= 0)[:, None], blocks[self.of_pixel], 0)


def coarser(transport: Transport, camera: Blocks, projector: Blocks) -> Transport:
    """Return A T E: A computes means of camera pixels, E the pixels that a coarse projector pixel lights."""
    far = transport.far
    if far is not None:
        gather = stacked([Csr(D @ projector.sums.T) for D in channels(far.gather)])
        scatter = stacked([Csr(camera.means @ U) for U in channels(far.scatter)])
        far = replace(far, gather=gather, scatter=scatter)
    return Transport(_between(camera, transport.near, projector), far, camera.coarse, projector.coarse)


def _between(camera: Blocks, near: SparseRows, projector: Blocks) -> SparseRows:
    rows = stacked([Csr(camera.means @ T @ projector.sums.T) for T in channels(near)])
    return replace(rows, weights=rows.weights.astype(np.float32))

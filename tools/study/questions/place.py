"""The room in which questions are tried, with pictures and their best drives; and the same room with fewer pixels.

Coarse camera pixels are means of pixels. A coarse projector pixel lights all the pixels that it contains.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from counterlight.arrays import FloatArray
from counterlight.calibration import Calibration
from counterlight.maps.row_map import SparseRows
from counterlight.pipeline.content import psnr
from counterlight.pipeline.fitting import on_cameras
from counterlight.raster import Shapes, side_by_side
from counterlight.screen import parts_of, raster_of
from counterlight.tools.colour.tiers import Tier, tier_of
from counterlight.tools.solve.box import Box
from counterlight.tools.study.pictures import Picture
from counterlight.tools.transport.objective import DEFAULT_AIMS, Objective, ObjectiveOptions, objective_of
from counterlight.tools.transport.transport import Csr, Shape, Transport, channels, stacked

MOST_PIXELS = 160 * 120  # largest number of camera pixels
GAP = 1e-3  # relative gap of the box optimum: 0.004 dB


class Layout(NamedTuple):
    """A raster: (height, width), and the rows and columns of each device's picture in it."""

    shape: Shape
    parts: tuple[tuple[slice, slice], ...]


def next_to_each_other(projectors: Shapes) -> Layout:
    """Return the layout of projectors, side by side."""
    shape, regions = side_by_side(projectors)
    return Layout(shape, tuple(region.part for region in regions))


def below_each_other(cameras: Shapes) -> Layout:
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
    layout: Callable[[Shapes], Layout] = next_to_each_other

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


@dataclass(frozen=True)
class Place:
    """A calibrated room.

    factor : pixels per side of the full-size room that one pixel here represents.
    """

    calibration: Calibration
    transport: Transport
    pictures: Sequence[Picture]
    colour: str = "auto"
    factor: int = 1

    @cached_property
    def tier(self) -> Tier:
        return tier_of(self.calibration, self.transport, self.colour)

    @cached_property
    def desired(self) -> list[FloatArray]:
        """The desired pictures, (camera height, camera width, 3) each, in screen primaries."""
        room = self.calibration
        return [self.tier.white * on_cameras(picture.at(room.placed_on), room) for picture in self.pictures]

    @cached_property
    def reached(self) -> list[float]:
        """PSNR of each picture with the unweighted optimum."""
        box = Box(self._objective.unweighted, tolerance=GAP)
        return self.psnr([box.solve(self.tier.target(each).reshape(-1, 3)).drive for each in self.desired])

    @cached_property
    def _objective(self) -> Objective:
        return objective_of(self.tier.transport, self.tier.calibration, DEFAULT_AIMS, self.tier.mixing)

    @property
    def size(self) -> str:
        """The size in words."""
        camera, projector = self.calibration.camera, self.calibration.projector
        words = f"camera {camera.width}x{camera.height}, projector {projector.width}x{projector.height}"
        return words if self.factor == 1 else f"{words}, each of its pixels {self.factor} a side of the room's own"

    def drives(
        self, tier: Tier, aims: ObjectiveOptions = DEFAULT_AIMS, desired: Sequence[FloatArray] | None = None
    ) -> list[FloatArray]:
        """Returns the best drive of each picture by the player's objective, in a tier of this or a derived room.

        desired : the pictures, if the derived camera has other pixels.
        """
        box = Box(objective_of(tier.transport, tier.calibration, aims, tier.mixing), tolerance=GAP)
        return [box.solve(tier.target(each).reshape(-1, 3)).drive for each in desired or self.desired]

    def psnr(self, drives: Sequence[FloatArray], seen: Callable[[FloatArray], FloatArray] | None = None) -> list[float]:
        """Returns the PSNR of each picture's drive in this room.

        seen : function from a drive to the camera picture, if not as calibrated.
        """
        lit, look = self._objective.lit_picture(self.calibration), seen or self.tier.seen
        errors = [(look(p) - each)[lit] / self.tier.white for p, each in zip(drives, self.desired, strict=True)]
        return [psnr(float(np.mean(np.square(error)))) for error in errors]

    def below(self, drives: Sequence[FloatArray], seen: Callable[[FloatArray], FloatArray] | None = None) -> float:
        """Returns the decibels below the best, mean over the pictures."""
        return float(np.mean(np.array(self.reached) - np.array(self.psnr(drives, seen))))


def coarse(place: Place, most: int = MOST_PIXELS) -> Place:
    """Returns the room with at most `most` camera pixels, so that slow questions take minutes."""
    factor = int(np.ceil(np.sqrt(place.calibration.camera.pixels / most)))
    if factor == 1:
        return place
    small = made_coarser(place.calibration, place.transport, factor, factor)
    return Place(*small, place.pictures, place.colour, place.factor * factor)


def made_coarser(
    calibration: Calibration, transport: Transport, camera: int, projector: int
) -> tuple[Calibration, Transport]:
    """Returns the room with coarser devices: each pixel replaces a square block of its own pixels.

    camera, projector : side of a block, pixels.
    """
    seen, shown = blocks_of(calibration, camera, projector)
    primaries, screen = calibration.primaries, calibration.screen
    small = replace(
        calibration,
        camera=replace(calibration.camera, height=seen.coarse[0], width=seen.coarse[1]),
        projectors=tuple(
            replace(each, height=height, width=width)
            for each, (height, width) in zip(calibration.projectors, shown.coarser, strict=True)
        ),
        ambient=seen.mean(calibration.ambient).astype(np.float32),
        mask=seen.whole(calibration.mask),
        primaries=primaries if primaries is None else np.stack([seen.mean(each) for each in primaries]).astype("f4"),
        screen=screen
        and replace(screen, cameras=seen.coarser, positions=seen.mean(screen.positions).astype(np.float32)),
    )
    return small, coarser(transport, seen, shown)


def blocks_of(calibration: Calibration, camera: int, projector: int) -> tuple[Blocks, Blocks]:
    """Returns blocks of camera pixels and of projector pixels, `camera` and `projector` pixels per side."""
    projectors = tuple(each.shape for each in calibration.projectors)
    return Blocks(calibration.cameras, camera, below_each_other), Blocks(projectors, projector)

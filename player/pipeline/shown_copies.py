"""Small copies of pictures on their device, for other processes: remote viewers, and a watcher (show/watching.py).

The watcher's copy of a shown drive holds the pictures of all projectors, reduced by an integer factor, next to each
other from the left.
"""

from collections.abc import Sequence
from typing import Generic

import numpy as np
from numpy.typing import NDArray

from counterlight.passes.certificate import BlockSum
from counterlight.passes.drawing import Picture
from counterlight.passes.means import Means, part
from counterlight.pipeline.device import Device, Owner, Owning
from counterlight.raster import Region, Shape
from counterlight.response import Response

FACTOR, NARROWEST = 4, 192  # factor of the reduction, and smallest width of a reduced picture
LONGEST = 480  # most pixels of the longer side


class ShownCopies(Owning, Generic[Picture]):
    """The means of a drive's pixels, and the means of these over a coarse grid.

    `take` only queues the draws. `grid` and `picture` read the results, and wait for them.

    regions : the projectors' regions in the raster.
    factor : pixels of the raster per pixel of the copy.
    grid : (rows, columns).
    """

    def __init__(
        self,
        device: Device[Picture],
        regions: Sequence[Region],
        factor: int,
        grid: tuple[int, int],
    ) -> None:
        self._owner, self._device = Owner(), device
        boxes = reduced_boxes(regions, factor)
        shape = reduced_shape(boxes)
        rows = [
            part(region, (box.height, box.width), (factor * box.height, factor * box.width))
            for region, box in zip(regions, boxes, strict=True)
        ]
        own = self._owner.own
        with self._owner:
            self._parts = own(device.picture(np.stack(rows)))
            self._whole = own(device.picture(part((0, 0, *shape[::-1]), grid)[None]))
            self._reduced, self._grid = own(device.canvas(shape)), own(device.canvas(grid))

    def take(self, drive: Picture) -> None:
        self._grid.draw(Means(self._reduced.draw(Means(drive, self._parts)), self._whole))

    def grid(self) -> NDArray[np.float32]:
        return self._device.read(self._grid.picture, np.float32)

    def picture(self) -> NDArray[np.float16]:
        return self._device.read(self._reduced.picture, np.float32).astype(np.float16)


def factor_of(width: int) -> int:
    """Return the factor by which pictures of a projector `width` pixels wide are reduced."""
    return max(1, min(FACTOR, width // NARROWEST))


def reduced_boxes(regions: Sequence[Region], factor: int) -> list[Region]:
    """Return the projectors' regions in a reduced picture, next to each other from the left."""
    found, left = list[Region](), 0
    for region in regions:
        found.append(Region(left, 0, -(-region.width // factor), -(-region.height // factor)))
        left += found[-1].width
    return found


def reduced_shape(boxes: Sequence[Region]) -> Shape:
    """Return the (height, width) of a copy."""
    return max(box.height for box in boxes), sum(box.width for box in boxes)


class SmallPicture(Owning, Generic[Picture]):
    """Means of blocks of linear light, as sRGB codes. Pixels left over at the right and lower edge are cut off.

    shape : (height, width) of the pictures.
    white : light of code 255.
    """

    def __init__(self, device: Device[Picture], shape: tuple[int, int], white: float) -> None:
        self._side = side = -(-max(shape) // LONGEST)
        small = max(1, shape[0] // side), max(1, shape[1] // side)
        self._owner = Owner()
        own = self._owner.own
        with self._owner:
            self._sums = own(device.canvas(small))
            self._encoder = own(device.encoder(small, Response("srgb").over(small), white * side**2, "none"))

    def run(self, light: Picture) -> Picture:
        return self._encoder.run(self._sums.draw(BlockSum(light, self._side)), 0)

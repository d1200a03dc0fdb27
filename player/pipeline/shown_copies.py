"""Small copies of each shown drive, for a process that watches the room (show/watching.py)."""

from collections.abc import Sequence
from typing import Generic

import numpy as np
from numpy.typing import NDArray

from counterlight.passes.drawing import Picture
from counterlight.passes.means import Means, part
from counterlight.pipeline.device import Device, Owner
from counterlight.raster import Region


class ShownCopies(Generic[Picture]):
    """The means of a drive's pixels, and the means of these over a coarse grid.

    `take` only queues the draws. `grid` and `picture` read the results, and wait for them.

    regions : of the projectors in the raster.
    boxes : of the projectors in the copy; left, top, width, height, next to each other from the left.
    factor : pixels of the raster per pixel of the copy.
    grid : (rows, columns).
    """

    def __init__(
        self,
        device: Device[Picture],
        regions: Sequence[Region],
        boxes: Sequence[tuple[int, int, int, int]],
        factor: int,
        grid: tuple[int, int],
    ) -> None:
        self._owner, self._device = Owner(), device
        shape = max(height for *_, height in boxes), sum(width for _, _, width, _ in boxes)
        rows = [
            part(region, (height, width), (factor * height, factor * width))
            for region, (_, _, width, height) in zip(regions, boxes, strict=True)
        ]
        own = self._owner.own
        try:
            self._parts = own(device.picture(np.stack(rows)))
            self._whole = own(device.picture(part((0, 0, *shape[::-1]), grid)[None]))
            self._reduced, self._grid = own(device.canvas(shape)), own(device.canvas(grid))
        except BaseException:
            self.release()
            raise

    def take(self, drive: Picture) -> None:
        self._grid.draw(Means(self._reduced.draw(Means(drive, self._parts)), self._whole))

    def grid(self) -> NDArray[np.float32]:
        return self._device.read(self._grid.picture, np.float32)

    def picture(self) -> NDArray[np.float16]:
        return self._device.read(self._reduced.picture, np.float32).astype(np.float16)

    def release(self) -> None:
        self._owner.release()

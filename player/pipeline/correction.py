"""A correction of the room during a show: what a watcher has found (docs/watch.md).

A new correction costs a table of a few numbers, and draws in the camera's size if the ambient light or the row gains
have changed. Maps stay as they are. All numbers are relative to the calibration, not to the correction before.
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Generic

import numpy as np
from numpy.typing import NDArray

from counterlight.passes.certificate import Inverse, Weighted
from counterlight.passes.combine import Combine
from counterlight.passes.drawing import Canvas, Picture
from counterlight.passes.moved import MovedDrive
from counterlight.passes.resample import Resample
from counterlight.pipeline.device import Device, Owner, Owning
from counterlight.pipeline.drift import Drift, Moved
from counterlight.pipeline.room import Room
from counterlight.raster import Shape

NO_LIGHT = np.zeros((1, 1, 3), np.float32)
MOST_BLOCKS = 5000  # most blocks of the camera picture that a watcher compares


@dataclass(frozen=True)
class Correction:
    """The state of a room, relative to its calibration.

    projectors : one entry per projector.
    ambient : (rows, columns, 3). Change of the ambient light, in screen primaries. The field covers the camera picture
        and is interpolated between the middles of its cells.
    paint : (camera height, camera width, 3), factor of the field for each camera pixel; None for 1.
    white : factor of a white picture's light.
    row_gains : (rows, columns, 3), factors g of the rows of T and of the ambient light, in screen primaries, one per
        block (`blocks_of`); 1 / g is interpolated between the middles of the blocks. None for 1.
    """

    projectors: tuple[Moved, ...]
    ambient: NDArray[np.float32] = field(default_factory=lambda: NO_LIGHT)
    paint: NDArray[np.floating] | None = None
    white: float = 1.0
    row_gains: NDArray[np.float32] | None = None


class CorrectedDrive(Owning, Generic[Picture]):
    """Maps a drive to the shown drive, for projectors that have moved or changed their light."""

    def __init__(self, device: Device[Picture], room: Room, projectors: tuple[Moved, ...]) -> None:
        self._owner, self._device, self._regions = Owner(), device, room.calibration.regions
        own = self._owner.own
        with self._owner:
            self._projectors = own(device.picture(self._table(projectors)))
            self._canvas = own(device.canvas(room.calibration.projector.shape))

    def set(self, projectors: tuple[Moved, ...]) -> None:
        self._device.write(self._projectors, self._table(projectors))

    def run(self, drive: Picture) -> Picture:
        return self._canvas.draw(MovedDrive(drive, self._projectors))

    def _table(self, projectors: tuple[Moved, ...]) -> NDArray[np.float32]:
        return Drift(projectors).table(self._regions)


class AmbientLight(Owning, Generic[Picture]):
    """The ambient light of a view in screen primaries, which a correction changes in place.

    picture : (camera height, camera width, 3), for all passes of the view.
    """

    def __init__(self, device: Device[Picture], room: Room) -> None:
        self._owner, self._device, self._room = Owner(), device, room
        self._shape = room.calibration.camera.shape
        self._parts: _AddedLight[Picture] | None = None
        self._paint: NDArray[np.floating] | None = None
        own = self._owner.own
        with self._owner:
            self._canvas = own(device.canvas(self._shape))
            stored = own(device.picture(room.ambient))
            self.picture: Picture = self._canvas.draw(Combine(stored, stored, 0.0))
            self._owner.give_up(stored)

    def add(self, field: NDArray[np.float32], paint: NDArray[np.floating] | None) -> None:
        """Set the picture to the calibrated light plus a field times `paint` (Correction)."""
        parts = self._parts
        if parts is None or parts.cells != field.shape[:2] or paint is not self._paint:
            if parts is None and not field.any():
                return
            self._owner.give_up(parts)
            self._paint, self._parts = paint, None
            parts = self._parts = self._owner.own(_AddedLight(self._device, self._room, field.shape[:2], paint))
        self._canvas.draw(Combine(parts.stored, parts.of(field)))


class _AddedLight(Owning, Generic[Picture]):
    """The pictures for a field of `cells`, (rows, columns)."""

    def __init__(
        self, device: Device[Picture], room: Room, cells: tuple[int, int], paint: NDArray[np.floating] | None
    ) -> None:
        self.cells, self._device, self._owner = cells, device, Owner()
        self._height, self._width = room.calibration.camera.shape
        own = self._owner.own
        with self._owner:
            self.stored = own(device.picture(room.ambient))
            self._field = own(device.picture(np.zeros((*cells, 3), np.float32)))
            self._wide, self._high = (own(device.canvas((rows, self._width))) for rows in (cells[0], self._height))
            self._paint = None if paint is None else own(device.picture(paint.astype(np.float32)))
            self._painted = None if paint is None else own(device.canvas((self._height, self._width)))

    def of(self, field: NDArray[np.float32]) -> Picture:
        self._device.write(self._field, field)
        wide = self._wide.draw(Resample(self._field, 0, 0, self._width))
        high = self._high.draw(Resample(wide, 1, 0, self._height))
        if self._painted is None or self._paint is None:
            return high
        return self._painted.draw(Weighted(high, self._paint))


class RowGains(Owning, Generic[Picture]):
    """The factors g of the rows of T: the camera sees g ∘ (T p + e). Targets are divided by g, like the columns of T⁺.

    gains, undo : g and 1 / g, (camera height, camera width, 3); None while g is 1, so that no frame pays for it.
    """

    def __init__(self, device: Device[Picture], room: Room) -> None:
        self._owner, self._device, self._shape = Owner(), device, room.calibration.camera.shape
        self.gains: Picture | None = None
        self.undo: Picture | None = None

    def set(self, gains: NDArray[np.float32] | None) -> None:
        """Set g (Correction)."""
        if gains is None:
            self.gains = self.undo = None
            return
        small, wide, undo, whole = self._pictures
        self._device.write(small, 1 / gains)
        (rows, columns), side = blocks_of(self._shape), block_side(self._shape)
        self.undo = undo.draw(Resample(wide.draw(Resample(small, 0, 0, columns * side)), 1, 0, rows * side))
        self.gains = whole.draw(Inverse(self.undo))

    @cached_property
    def _pictures(self) -> tuple[Picture, Canvas[Picture], Canvas[Picture], Canvas[Picture]]:
        """The picture of the blocks, and the canvases for the widened blocks, 1 / g and g."""
        own, blocks = self._owner.own, blocks_of(self._shape)
        small = own(self._device.picture(np.ones((*blocks, 3), np.float32)))
        wide, undo, whole = (
            own(self._device.canvas(each)) for each in ((blocks[0], self._shape[1]), *[self._shape] * 2)
        )
        return small, wide, undo, whole


def block_side(camera: Shape) -> int:
    """Return the side of a watcher's square blocks, camera pixels."""
    return max(1, int(np.ceil(np.sqrt(camera[0] * camera[1] / MOST_BLOCKS))))


def blocks_of(camera: Shape) -> tuple[int, int]:
    """Return the rows and columns of blocks that cover the camera picture; the last ones may reach beyond it."""
    side = block_side(camera)
    return -(-camera[0] // side), -(-camera[1] // side)

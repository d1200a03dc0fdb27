"""The passes of a frame that depend on the medium's format. The next medium's passes can be made in advance."""

from functools import cached_property
from typing import Generic

import numpy as np

from counterlight.media.frames import PixelFormat
from counterlight.passes.combine import Blend
from counterlight.passes.drawing import Canvas, Picture
from counterlight.passes.mixing import Recolour
from counterlight.pipeline.device import Device, Owner, Owning
from counterlight.pipeline.fitting import Axes, Fitter, Pinner
from counterlight.pipeline.placement import Corners, shown_shape
from counterlight.pipeline.room import Room


class Placed(Owning, Generic[Picture]):
    """Places decoded pictures of one format in one camera's view, and on the projector.

    axes : screen positions of a screen shared by several cameras; None for one camera.
    targets : (height, width) of the camera's picture, and of the projector's.
    radiance : whether the pictures are camera radiance.
    unit : share of white that a picture's 1 stands for.
    """

    def __init__(self, device: Device[Picture], room: Room, axes: Axes[Picture] | None, pixels: PixelFormat) -> None:
        self._device, self._axes, self._pixels = device, axes, pixels
        self.targets = room.calibration.camera.shape, room.calibration.projector.shape
        self._owner = Owner()
        self.radiance = pixels.layout == "radiance"
        self.unit = 1 / room.white if self.radiance else 1.0
        own = self._owner.own
        with self._owner:
            self._fitter = own(self._make_fitter())
            self._plain_fitter = own(Fitter(device, pixels, self.targets[1]))
            self._recoloured = own(self._make_recoloured(room)) if self.radiance else None
        self.pin(None)

    def pin(self, corners: Corners | None) -> None:
        """Pin the picture to these corners; None fits it as large as possible.

        Radiance of several cameras is not pinned: corners on the shared screen do not apply to one camera's picture.
        """
        self.pinned = corners is not None and not (self.radiance and self._axes is not None)
        self._placing: Fitter[Picture] | Pinner[Picture] = self._fitter
        if corners is not None and self.pinned:
            self._pinner.pin(corners, shown_shape(self._pixels))
            self._placing = self._pinner

    def in_view(self, picture: Picture) -> Picture:
        """Return the picture in the camera's view; valid until the next call."""
        return self._placing.run(self._on_screen(picture))

    def on_projector(self, picture: Picture) -> Picture:
        """Return the picture fitted to the projector; valid until the next call."""
        return self._plain_fitter.run(self._on_screen(picture))

    def _on_screen(self, picture: Picture) -> Picture:
        """Return a decoded picture in screen primaries; only radiance needs a conversion."""
        return picture if self._recoloured is None else self._recoloured.draw(Recolour(picture, self._to_screen))

    def _make_recoloured(self, room: Room) -> Canvas[Picture] | None:
        """Return a canvas for radiance in screen primaries; None if these are the camera's primaries."""
        self._to_screen = room.mixing.to_screen.T.ravel().astype(np.float32)  # column by column, as OpenGL expects
        return None if room.mixing.neutral is None else self._device.canvas(shown_shape(self._pixels))

    def _make_fitter(self) -> Fitter[Picture] | Pinner[Picture]:
        """Return a fitter into the camera's view, or onto a shared screen. Radiance maps to camera pixels directly."""
        if self._axes is None or self.radiance:
            return Fitter(self._device, self._pixels, self.targets[0])
        fitter = Pinner(self._device, self.targets[0], self._axes)
        fitter.fit(self._pixels)
        return fitter

    @cached_property
    def _pinner(self) -> Pinner[Picture]:
        return self._owner.own(Pinner(self._device, self.targets[0], self._axes))


class Crossfade(Owning, Generic[Picture]):
    """Replaces a medium's Placed during a crossfade: (1 − weight) now + weight before, in linear light.

    The desired pictures are blended before compensation, because compensation of a sum is not a sum of compensations.

    weight : weight of the previous medium, 1 at first.
    """

    def __init__(self, device: Device[Picture], now: Placed[Picture], before: Placed[Picture]) -> None:
        self.radiance, self.unit = now.radiance, now.unit
        self._now, self._before, self._owner = now, before, Owner()
        self._weight, self._gain = 1.0, before.unit / now.unit
        with self._owner:
            self._in_view, self._on_projector = (self._owner.own(device.canvas(target)) for target in now.targets)

    @property
    def pinned(self) -> bool:
        return self._now.pinned or self._before.pinned

    def pin(self, corners: Corners | None) -> None:
        self._now.pin(corners)
        self._before.pin(corners)

    def set(self, weight: float) -> None:
        self._weight = weight

    def take(self, before: Picture) -> None:
        """Set the decoded picture of the previous medium."""
        self._decoded = before

    def in_view(self, picture: Picture) -> Picture:
        now, before = self._now.in_view(picture), self._before.in_view(self._decoded)
        return self._in_view.draw(Blend(now, before, self._weight, self._gain))

    def on_projector(self, picture: Picture) -> Picture:
        now, before = self._now.on_projector(picture), self._before.on_projector(self._decoded)
        return self._on_projector.draw(Blend(now, before, self._weight, self._gain))

"""The passes of a frame that depend on the medium's format. The next medium's passes can be made in advance."""

from functools import cached_property
from typing import NamedTuple

from counterlight.media.frames import PixelFormat
from counterlight.pipeline.device import Device, Light, Owner
from counterlight.pipeline.fitting import Axes, Fitter, Pinner
from counterlight.pipeline.mixer import Mixer
from counterlight.pipeline.placement import Corners, shown_shape
from counterlight.pipeline.room import Room


class Placed:
    """Places decoded pictures of one format in one camera's view, and on the projector.

    axes : screen positions of a screen shared by several cameras; None for one camera.
    targets : (height, width) of the camera's picture, and of the projector's.
    radiance : whether the pictures are camera radiance.
    unit : share of white that a picture's 1 stands for.
    """

    def __init__(self, device: Device, room: Room, mixer: Mixer, axes: Axes | None, pixels: PixelFormat) -> None:
        self._device, self._axes, self._pixels = device, axes, pixels
        self.targets = room.calibration.camera.shape, room.calibration.projector.shape
        self._owner = Owner()
        self.radiance = pixels.layout == "radiance"
        self.unit = 1 / room.white if self.radiance else 1.0
        own = self._owner.own
        try:
            self._fitter = own(self._make_fitter())
            self._plain_fitter = own(Fitter(device, pixels, self.targets[1]))
            self._recolour = own(mixer.recolour(shown_shape(pixels))) if self.radiance else None
        except BaseException:
            self.release()
            raise
        self.pin(None)

    def pin(self, corners: Corners | None) -> None:
        """Pin the picture to these corners; None fits it as large as possible.

        Radiance of several cameras is not pinned: corners on the shared screen do not apply to one camera's picture.
        """
        self.pinned = corners is not None and not (self.radiance and self._axes is not None)
        self._placing: Fitter | Pinner = self._fitter
        if corners is not None and self.pinned:
            self._pinner.pin(corners, shown_shape(self._pixels))
            self._placing = self._pinner

    def in_view(self, picture: Light) -> Light:
        """Return the picture in the camera's view; valid until the next call."""
        return self._placing.run(self._on_screen(picture))

    def on_projector(self, picture: Light) -> Light:
        """Return the picture fitted to the projector; valid until the next call."""
        return self._plain_fitter.run(self._on_screen(picture))

    def release(self) -> None:
        self._owner.release()

    def _on_screen(self, picture: Light) -> Light:
        """Return a decoded picture in screen primaries; only radiance needs a conversion."""
        return picture if self._recolour is None else self._recolour.run(picture=picture)

    def _make_fitter(self) -> Fitter | Pinner:
        """Return a fitter into the camera's view, or onto a shared screen. Radiance maps to camera pixels directly."""
        if self._axes is None or self.radiance:
            return Fitter(self._device, self._pixels, self.targets[0])
        fitter = Pinner(self._device, self.targets[0], self._axes)
        fitter.fit(self._pixels)
        return fitter

    @cached_property
    def _pinner(self) -> Pinner:
        return self._owner.own(Pinner(self._device, self.targets[0], self._axes))


class Two(NamedTuple):
    """Decoded pictures of two media during a crossfade."""

    now: Light
    before: Light


class Crossfade:
    """Replaces a medium's Placed during a crossfade: (1 − weight) now + weight before, in linear light.

    The desired pictures are blended before compensation, because compensation of a sum is not a sum of compensations.

    weight : weight of the previous medium, 1 at first.
    """

    def __init__(self, device: Device, now: Placed, before: Placed) -> None:
        self.radiance, self.unit = now.radiance, now.unit
        self._now, self._before, self._owner = now, before, Owner()
        gain = before.unit / now.unit
        try:
            self._in_view, self._on_projector = (
                self._owner.own(device.make_pass("blend.frag", target, weight=1.0, gain=gain)) for target in now.targets
            )
        except BaseException:
            self.release()
            raise

    @property
    def pinned(self) -> bool:
        return self._now.pinned or self._before.pinned

    def pin(self, corners: Corners | None) -> None:
        self._now.pin(corners)
        self._before.pin(corners)

    def set(self, weight: float) -> None:
        self._in_view.set(weight=weight)
        self._on_projector.set(weight=weight)

    def in_view(self, two: Two) -> Light:
        return self._in_view.run(now=self._now.in_view(two.now), before=self._before.in_view(two.before))

    def on_projector(self, two: Two) -> Light:
        return self._on_projector.run(now=self._now.on_projector(two.now), before=self._before.on_projector(two.before))

    def release(self) -> None:
        self._owner.release()

"""The passes of a frame that depend on the medium's format, so that the next medium's can be made before its turn."""

from functools import cached_property

from counterlight.media.frames import PixelFormat
from counterlight.pipeline.device import Device, Light, Owner
from counterlight.pipeline.fitting import Axes, Fitter, Pinner
from counterlight.pipeline.mixer import Mixer
from counterlight.pipeline.placement import Corners, shown_shape
from counterlight.pipeline.room import Room


class Placed:
    """Places the decoded pictures of one format in one camera's view, and as they fit the projector.

    axes : of a screen that several cameras look at; None for one camera.
    radiance : whether the pictures are the camera's radiance.  unit : share of white of a picture's 1.
    """

    def __init__(self, device: Device, room: Room, mixer: Mixer, axes: Axes | None, pixels: PixelFormat) -> None:
        self._device, self._axes, self._pixels = device, axes, pixels
        self._camera, self._owner = room.calibration.camera.shape, Owner()
        self.radiance = pixels.layout == "radiance"
        self.unit = 1 / room.white if self.radiance else 1.0
        own = self._owner.own
        try:
            self._fitter = own(self._make_fitter())
            self._plain_fitter = own(Fitter(device, pixels, room.calibration.projector.shape))
            self._recolour = own(mixer.recolour(shown_shape(pixels))) if self.radiance else None
        except BaseException:
            self.release()
            raise
        self.pin(None)

    def pin(self, corners: Corners | None) -> None:
        """Have the picture's corners there; None: as large as fits.

        Radiance of several cameras stays as it is: the screen of several has no corners of one camera's picture.
        """
        self.pinned = corners is not None and not (self.radiance and self._axes is not None)
        self._placing: Fitter | Pinner = self._fitter
        if corners is not None and self.pinned:
            self._pinner.pin(corners, shown_shape(self._pixels))
            self._placing = self._pinner

    def in_view(self, picture: Light) -> Light:
        """In the camera's view, valid until the next call."""
        return self._placing.run(self._on_screen(picture))

    def on_projector(self, picture: Light) -> Light:
        """As the picture fits the projector, valid until the next call."""
        return self._plain_fitter.run(self._on_screen(picture))

    def release(self) -> None:
        self._owner.release()

    def _on_screen(self, picture: Light) -> Light:
        """A decoded picture in screen primaries; only radiance is in others."""
        return picture if self._recolour is None else self._recolour.run(picture=picture)

    def _make_fitter(self) -> Fitter | Pinner:
        """Into the camera's view, or onto the screen of several; radiance is the camera's, pixel by pixel."""
        if self._axes is None or self.radiance:
            return Fitter(self._device, self._pixels, self._camera)
        fitter = Pinner(self._device, self._camera, self._axes)
        fitter.fit(self._pixels)
        return fitter

    @cached_property
    def _pinner(self) -> Pinner:
        return self._owner.own(Pinner(self._device, self._camera, self._axes))

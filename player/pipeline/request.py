"""The targets of a frame: light in the camera's view, and the drive without compensation."""

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from counterlight.media.frames import PixelFormat
from counterlight.pipeline.adjustments import NEUTRAL, Adjustments
from counterlight.pipeline.device import Adapter, Device, Light, NearLight, Owner, Pass
from counterlight.pipeline.fitting import Axes
from counterlight.pipeline.map_views import MapViews
from counterlight.pipeline.mixer import Mixer
from counterlight.pipeline.placed import Crossfade, Placed
from counterlight.pipeline.room import Room
from counterlight.pipeline.test_cards import card


class Request:
    """Places and tones the decoded picture. With neutral settings, the passes skip the tone.

    ambient : ambient light in screen primaries.
    maps, near_light : inputs of the adaptation.
    mixer : mixing of the room.
    """

    def __init__(
        self,
        device: Device,
        room: Room,
        ambient: Light,
        maps: MapViews,
        near_light: NearLight,
        mixer: Mixer,
    ) -> None:
        self._device, self._room, self._ambient = device, room, ambient
        self._maps, self._near_light, self._mixer = maps, near_light, mixer
        self._camera, self._projector = room.calibration.camera.shape, room.calibration.projector.shape
        self._owner = Owner()
        self._adjustments, self._unit, self._level = NEUTRAL, 1.0, 1.0
        own = self._owner.own
        try:
            self._rows, self._defines = mixer.rows, mixer.defines
            self._black = own(device.picture(np.zeros((*self._projector, 3), np.float32)))
            self._limits: dict[str, int | None] = {"FULL": None} if room.maps.bounded else {}
            self._uniforms = mixer.uniforms if room.maps.bounded else {}
            defines = self._limits | self._defines
            self._desired = own(device.make_pass("desired.frag", self._camera, defines, **self._uniforms))
            self._plain = own(device.make_pass("desired.frag", self._projector, {"CLAMP": None}))
        except BaseException:
            self._owner.release()
            raise

    def make(self, pixels: PixelFormat) -> Placed:
        """Return the passes of a format, for `open`; the caller releases them."""
        return Placed(self._device, self._room, self._mixer, self._axes, pixels)

    def open(self, placed: Placed | Crossfade, adjustments: Adjustments) -> None:
        """Accept pictures of a format from now on."""
        self.take(placed)
        self._adjustments = NEUTRAL
        if self._limits:
            _ = self._maps.full  # made now, so that no frame makes it
        self.adjust(adjustments)

    def take(self, placed: Placed | Crossfade) -> None:
        """Switch to another placing of the same medium."""
        self._placed, self._unit = placed, placed.unit
        self._tell_white()

    def fade(self, level: float) -> None:
        """Scale the light: 0 is black, 1 is full."""
        self._level = level
        self._tell_white()

    def _tell_white(self) -> None:
        """Set the light of a placed picture's 1 in every pass. Passes with a tone count in shares of white."""
        white, level = self._room.white, self._level
        self._desired.set(white=level if self._placed.radiance else level * white)
        self._plain.set(white=level * self._unit)
        if self._toned:
            self._toned_desired.set(white=level * white)
            self._toned_plain.set(white=level)

    def adjust(self, adjustments: Adjustments) -> None:
        previous, self._adjustments = self._adjustments, adjustments
        self._placed.pin(adjustments.corners)
        self._tell_white()
        if self._toned:
            self._toned_desired.set(unit=self._unit, black_level=adjustments.black_level)
            self._toned_plain.set(unit=self._unit, black_level=adjustments.black_level)
        if adjustments.adapt and (adjustments.adapt, adjustments.black_level) != (previous.adapt, previous.black_level):
            self._adapter.set(adjustments.adapt, self._unit, adjustments.black_level)
        if adjustments.card is not None and adjustments.card != previous.card:
            self._device.write(self._card, card(adjustments.card, self._projector))

    def advance(self, *, cut: bool, duration_s: float) -> None:
        if self._adjustments.adapt:
            self._adapter.advance(cut=cut, duration_s=duration_s)

    def light(self, picture: Light) -> Light:
        """Return the target b = c − e of a decoded picture, limited to 0..T·1 if the maps bound it."""
        placed, told = self._placed.in_view(picture), {"ambient": self._ambient, **self._rows}
        if self._limits:
            told["full"] = self._maps.full
        if not self._toned:
            return self._desired.run(picture=placed, **told)
        return self._toned_desired.run(picture=placed, tone=self._tone(placed), **told)

    def unbounded(self, picture: Light) -> Light:
        """Return c − e without limits, for the views that show errors."""
        placed, asked = self._placed.in_view(picture), self._toned_unbounded
        asked.set(white=self._level * self._room.white, unit=self._unit, black_level=self._adjustments.black_level)
        return asked.run(picture=placed, ambient=self._ambient, tone=self._tone(placed), **self._rows)

    def plain(self, picture: Light) -> Light:
        """Return the drive without compensation: the test card, or the picture fitted to the projector."""
        if self._adjustments.card is not None:
            return self._card
        placed = self._placed.on_projector(picture)
        if not self._adjustments.black_level:
            return self._plain.run(picture=placed, ambient=self._black)
        return self._toned_plain.run(picture=placed, ambient=self._black, tone=self._no_tone)

    def desired(self, picture: Light) -> NDArray[np.float32]:
        """Return c, (camera height, camera width, 3), in screen primaries."""
        if self._toned or self._placed.pinned:
            return self._device.read(self._mixer.on_screen(self.unbounded(picture)), np.float32) + self._room.ambient
        white = self._level * (1.0 if self._placed.radiance else self._room.white)
        return np.float32(white) * self._device.read(self._placed.in_view(picture), np.float32)

    def release(self) -> None:
        self._owner.release()

    def _tone(self, placed: Light) -> Light:
        return self._adapter.run(placed) if self._adjustments.adapt else self._no_tone

    @property
    def _toned(self) -> bool:
        return bool(self._adjustments.adapt or self._adjustments.black_level)

    @cached_property
    def _axes(self) -> Axes | None:
        screen = self._room.calibration.screen
        return None if screen is None else self._owner.own(Axes(self._device, screen))

    @cached_property
    def _adapter(self) -> Adapter:
        near_light, mixer = self._near_light, self._mixer
        adapter = self._owner.own(
            self._device.adapter(
                lambda light: near_light(mixer.asked(light)), self._ambient, self._maps.most, self._room.white
            )
        )
        adapter.set(self._adjustments.adapt, self._unit, self._adjustments.black_level)
        return adapter

    @cached_property
    def _toned_desired(self) -> Pass:
        return self._make_toned(self._limits, **self._uniforms)

    @cached_property
    def _toned_unbounded(self) -> Pass:
        return self._make_toned({})

    def _make_toned(self, defines: dict[str, int | None], **uniforms: NDArray[np.float32]) -> Pass:
        told, white = {"TONE": None, **self._defines, **defines}, self._room.white
        return self._owner.own(self._device.make_pass("desired.frag", self._camera, told, white=white, **uniforms))

    @cached_property
    def _toned_plain(self) -> Pass:
        return self._owner.own(
            self._device.make_pass("desired.frag", self._projector, {"TONE": None, "CLAMP": None}, white=1.0)
        )

    @cached_property
    def _no_tone(self) -> Light:
        return self._owner.own(self._device.picture(np.array([[[1, 0, 0]]], np.float32)))

    @cached_property
    def _card(self) -> Light:
        return self._owner.own(self._device.picture(np.zeros((*self._projector, 3), np.float32)))

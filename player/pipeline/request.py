"""The targets of a frame: light in the camera's view, and the drive without compensation."""

from functools import cached_property
from typing import Generic

import numpy as np
from numpy.typing import NDArray

from counterlight.media.frames import PixelFormat
from counterlight.passes.desired import Desired, Tone
from counterlight.passes.drawing import Canvas, Picture
from counterlight.pipeline.adjustments import NEUTRAL, Adjustments
from counterlight.pipeline.correction import RowGains
from counterlight.pipeline.device import Adapter, Device, NearLight, Owner, Owning
from counterlight.pipeline.fitting import Axes
from counterlight.pipeline.map_views import MapViews
from counterlight.pipeline.mixer import Mixer
from counterlight.pipeline.placed import Crossfade, Placed
from counterlight.pipeline.room import Room
from counterlight.pipeline.test_cards import card


class Request(Owning, Generic[Picture]):
    """Places and tones the decoded picture. With neutral settings, the passes skip the tone.

    ambient : ambient light in screen primaries.
    row_gains : changes of the room's light.
    maps, near_light : inputs of the adaptation.
    mixer : mixing of the room.
    """

    def __init__(
        self,
        device: Device[Picture],
        room: Room,
        ambient: Picture,
        row_gains: RowGains[Picture],
        maps: MapViews[Picture],
        near_light: NearLight[Picture],
        mixer: Mixer[Picture],
    ) -> None:
        self._device, self._room, self._ambient, self._row_gains = device, room, ambient, row_gains
        self._maps, self._near_light, self._mixer = maps, near_light, mixer
        self._camera, self._projector = room.calibration.camera.shape, room.calibration.projector.shape
        self._owner = Owner()
        self._adjustments, self._level, self._room_white = NEUTRAL, 1.0, room.white
        own = self._owner.own
        with self._owner:
            self._black = own(device.picture(np.zeros((*self._projector, 3), np.float32)))
            self._desired, self._plain = own(device.canvas(self._camera)), own(device.canvas(self._projector))

    def make(self, pixels: PixelFormat) -> Placed[Picture]:
        """Return the passes of a format, for `open`; the caller releases them."""
        return Placed(self._device, self._room, self._axes, pixels)

    def open(self, placed: Placed[Picture] | Crossfade[Picture], adjustments: Adjustments) -> None:
        """Accept pictures of a format from now on."""
        self.take(placed)
        self._adjustments = NEUTRAL
        _ = self._full, self._mixer.rows  # computed now, so that no frame has to compute it
        self.adjust(adjustments)

    def take(self, placed: Placed[Picture] | Crossfade[Picture]) -> None:
        """Switch to another placing of the same medium."""
        self._placed = placed

    def fade(self, level: float) -> None:
        """Scale the light: 0 is black, 1 is full."""
        self._level = level

    def scale_white(self, factor: float) -> None:
        """Set the radiance of a white picture to a multiple of the room's white. Pictures of radiance do not change."""
        self._room_white = factor * self._room.white

    def adjust(self, adjustments: Adjustments) -> None:
        previous, self._adjustments = self._adjustments, adjustments
        self._placed.pin(adjustments.corners)
        if adjustments.adapt and (adjustments.adapt, adjustments.black_level) != (previous.adapt, previous.black_level):
            self._adapter.set(adjustments.adapt, self._placed.unit, adjustments.black_level)
        if adjustments.card is not None and adjustments.card != previous.card:
            self._device.write(self._card, card(adjustments.card, self._projector))

    def advance(self, *, cut: bool, duration_s: float) -> None:
        if self._adjustments.adapt:
            self._adapter.advance(cut=cut, duration_s=duration_s)

    def light(self, picture: Picture) -> Picture:
        """Return the target b = c − e of a decoded picture, limited to 0..T·1 if the maps bound it."""
        placed = self._placed.in_view(picture)
        tone = self._tone(placed) if self._toned else None
        white = self._white if tone is None else self._level * self._room_white
        squares = self._mixer.squares if self._room.maps.bounded else None
        rows, weights = self._mixer.rows, self._row_gains.undo
        made = Desired(placed, self._ambient, white, tone, self._full, mixed=rows, squares=squares, weights=weights)
        return self._desired.draw(made)

    def unbounded(self, picture: Picture, *, weighed: bool = True) -> Picture:
        """Return b without limits, for the views that show errors; `weighed` as for b, otherwise exactly c − e."""
        placed, white = self._placed.in_view(picture), self._level * self._room_white
        weights = self._row_gains.undo if weighed else None
        made = Desired(placed, self._ambient, white, self._tone(placed), mixed=self._mixer.rows, weights=weights)
        return self._unbounded.draw(made)

    def plain(self, picture: Picture) -> Picture:
        """Return the drive without compensation: the test card, or the picture fitted to the projector."""
        if self._adjustments.card is not None:
            return self._card
        placed, black, level = self._placed.on_projector(picture), self._adjustments.black_level, self._level
        if not black:
            return self._plain.draw(Desired(placed, self._black, level * self._placed.unit, clamp=True))
        tone = Tone(self._no_tone, self._placed.unit, black)
        return self._plain.draw(Desired(placed, self._black, level, tone, clamp=True))

    def desired(self, picture: Picture) -> NDArray[np.float32]:
        """Return c, (camera height, camera width, 3), in screen primaries."""
        if self._toned or self._placed.pinned:
            return (
                self._device.read(self._mixer.on_screen(self.unbounded(picture, weighed=False)), np.float32)
                + self._room.ambient
            )
        return np.float32(self._white) * self._device.read(self._placed.in_view(picture), np.float32)

    def _tone(self, placed: Picture) -> Tone[Picture]:
        tone = self._adapter.run(placed) if self._adjustments.adapt else self._no_tone
        return Tone(tone, self._placed.unit, self._adjustments.black_level)

    @property
    def _white(self) -> float:
        """Camera radiance of the value 1 in a placed picture. Pictures with a tone are shares of white."""
        return self._level * (1.0 if self._placed.radiance else self._room_white)

    @property
    def _toned(self) -> bool:
        return bool(self._adjustments.adapt or self._adjustments.black_level)

    @property
    def _full(self) -> Picture | None:
        return self._maps.full if self._room.maps.bounded else None

    @cached_property
    def _axes(self) -> Axes[Picture] | None:
        screen = self._room.calibration.screen
        return None if screen is None else self._owner.own(Axes(self._device, screen))

    @cached_property
    def _adapter(self) -> Adapter[Picture]:
        near_light, mixer = self._near_light, self._mixer
        adapter = self._owner.own(
            self._device.adapter(
                lambda light: near_light(mixer.unmixed(light)), self._ambient, self._maps.most, self._room.white
            )
        )
        adapter.set(self._adjustments.adapt, self._placed.unit, self._adjustments.black_level)
        return adapter

    @cached_property
    def _unbounded(self) -> Canvas[Picture]:
        return self._owner.own(self._device.canvas(self._camera))

    @cached_property
    def _no_tone(self) -> Picture:
        return self._owner.own(self._device.picture(np.array([[[1, 0, 0]]], np.float32)))

    @cached_property
    def _card(self) -> Picture:
        return self._owner.own(self._device.picture(np.zeros((*self._projector, 3), np.float32)))

"""From drives to shown pictures: the predicted camera picture, and the maps drawn over it or instead of it."""

from functools import cached_property
from typing import Generic

import numpy as np

from counterlight.maps.mixing import UNLIMITED
from counterlight.passes.certificate import Weighted
from counterlight.passes.drawing import Canvas, Picture, Rows
from counterlight.passes.mixing import Mix
from counterlight.passes.product import Combining
from counterlight.passes.reach import Reach
from counterlight.passes.shown_maps import Clipping, ErrorMap, Impossible
from counterlight.pipeline.correction import RowGains
from counterlight.pipeline.device import Device, Owner, Owning, StoredMaps, SumPass
from counterlight.pipeline.mixer import Mixer
from counterlight.pipeline.views import (
    CLIP_FAINT,
    CLIP_SPAN,
    ERROR_SPAN,
    IMPOSSIBLE,
    MID_GREY,
    OVER,
    SLACK,
    UNCOUNTED,
    UNDER,
    error_colours,
)

CLIP_COLOURS = CLIP_FAINT, CLIP_SPAN, OVER, UNDER


class Observer(Owning, Generic[Picture]):
    """Predicts the camera picture of a drive, in screen primaries: g ∘ (e + B T p).

    row_gains : g; None for the calibrated room.
    far : whether far light is included.
    """

    def __init__(
        self,
        stored: StoredMaps[Picture],
        ambient: Picture,
        mixer: Mixer[Picture],
        row_gains: RowGains[Picture] | None = None,
        *,
        far: bool = True,
    ) -> None:
        maps, self._owner = stored.room.maps, Owner()
        own = self._owner.own
        chains = [chain for chain in maps.chains if far or chain is not maps.far]
        adding: list[Combining] = ["ADD_TO_BASE"] * (1 + len(chains))
        self._transport = own(SumPass(stored, maps.transport, chains, adding))
        self._ambient, self._mixer, self._row_gains = ambient, mixer, row_gains
        self._seen = own(mixer.canvas()) if mixer.mixes else None

    def run(self, drive: Picture) -> Picture:
        rows = self._mixer.seen_rows
        if self._seen is None or rows is None:
            seen = self._transport.run(drive, self._ambient)
        else:
            seen = self._seen.draw(Mix(self.light(drive), self._ambient, rows))
        gains = None if self._row_gains is None else self._row_gains.gains
        return seen if gains is None else self._changed.draw(Weighted(seen, gains))

    @cached_property
    def _changed(self) -> Canvas[Picture]:
        return self._owner.own(self._mixer.canvas())

    def light(self, drive: Picture) -> Picture:
        """Return T p."""
        return self._transport.run(drive, self._mixer.black)


class MapViews(Owning, Generic[Picture]):
    """The views that are maps, and the map of clipping over other views (views.py). Each is built on first use.

    stored, ambient, mixer : as in Observer.
    """

    def __init__(
        self, device: Device[Picture], stored: StoredMaps[Picture], ambient: Picture, mixer: Mixer[Picture]
    ) -> None:
        self._device, self._stored, self._ambient, self._mixer = device, stored, ambient, mixer
        self._owner, self._room = Owner(), stored.room
        self._camera, self._projector = self._room.calibration.camera.shape, self._room.calibration.projector.shape

    @cached_property
    def reach(self) -> Picture:
        """The brightest grey that each primary allows a pixel; alpha says whether the pixel counts."""
        rows = self._mixer.rows
        if rows is None:
            return self._full_drive(self._ambient, with_ambient=True)
        return self._full_drive(self._ambient, mixed=rows)

    @cached_property
    def full(self) -> Picture:
        """T·1, the light of full drive."""
        return self._full_drive(self._mixer.black)

    @cached_property
    def most(self) -> Picture:
        """(S + B P)·1, the light of full drive without far light; alpha says whether a camera pixel counts."""
        return self._full_drive(self._mixer.black, far=False)

    def _full_drive(
        self,
        ambient: Picture,
        *,
        with_ambient: bool = False,
        mixed: Rows[Picture] | None = None,
        far: bool = True,
    ) -> Picture:
        """Draw Reach over the light of full drive. with_ambient : whether this light includes ambient light."""
        temporary = Owner()
        try:
            observer = temporary.own(Observer(self._stored, self._ambient, self._mixer, far=far))
            canvas = self._owner.own(self._device.canvas(self._camera, Reach.channels))
            drive = temporary.own(self._device.picture(np.ones((*self._projector, 3), np.float32)))
            mask = temporary.own(self._device.mask(self._room.calibration.mask))
            seen = observer.run(drive) if with_ambient else observer.light(drive)
            return canvas.draw(Reach(seen, ambient, mask, mixed, None if mixed is None else UNLIMITED))
        finally:
            temporary.release()

    def error(self, seen: Picture, b: Picture) -> Picture:
        wanted, white = self._mixer.on_screen(b), self._room.white
        made = ErrorMap(seen, wanted, self._ambient, self.reach, self._error_colours, white, ERROR_SPAN, UNCOUNTED)
        return self._error.draw(made)

    def impossible(self) -> Picture:
        white = self._room.white
        return self._impossible.draw(Impossible(self.reach, self._impossible_colours, white, MID_GREY * white, SLACK))

    def over_camera(self, view: Picture, near_light: Picture) -> Picture:
        """Draw clipping over a camera view. near_light : near light of the target."""
        return self._over_camera.draw(Clipping(view, near_light, self._room.white, *CLIP_COLOURS, self.most))

    def over_projector(self, view: Picture, product: Picture) -> Picture:
        """Draw clipping over the projector view. product : T⁺ b, not clamped."""
        return self._over_projector.draw(Clipping(view, product, 1.0, *CLIP_COLOURS))

    @cached_property
    def _error(self) -> Canvas[Picture]:
        return self._owner.own(self._device.canvas(self._camera))

    @cached_property
    def _error_colours(self) -> Picture:
        return self._owner.own(self._device.picture(error_colours()[None]))

    @cached_property
    def _impossible(self) -> Canvas[Picture]:
        return self._owner.own(self._device.canvas(self._camera))

    @cached_property
    def _impossible_colours(self) -> Picture:
        return self._owner.own(self._device.picture(IMPOSSIBLE[None]))

    @cached_property
    def _over_camera(self) -> Canvas[Picture]:
        return self._owner.own(self._device.canvas(self._camera))

    @cached_property
    def _over_projector(self) -> Canvas[Picture]:
        return self._owner.own(self._device.canvas(self._projector))

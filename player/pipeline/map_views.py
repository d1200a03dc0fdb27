"""From drives to what is shown: the camera's prediction, and the maps over and instead of it."""

from collections.abc import Callable, Mapping
from functools import cached_property

import numpy as np

from counterlight.maps.mixing import UNLIMITED
from counterlight.pipeline.device import Device, FarPass, Light, Owner, Pass, StoredMaps
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


class Observer:
    """What the camera sees of a drive, in screen primaries: e + B (S p + U M D p)."""

    def __init__(self, device: Device, stored: StoredMaps, ambient: Light, mixer: Mixer) -> None:
        maps, self._owner = stored.room.maps, Owner()
        own, camera = self._owner.own, stored.room.calibration.camera.shape
        self._near = own(stored.of(maps.transport).product("ADD_TO_BASE"))
        self._far = None if maps.far is None else own(FarPass(stored, maps.far, "ADD_TO_BASE"))
        self._ambient, self._mixer = ambient, mixer
        self._black = own(device.picture(np.zeros((*camera, 3), np.float32)))
        if mixer.mixes:
            self._seen = own(mixer.seen())

    def run(self, drive: Light) -> Light:
        if not self._mixer.mixes:
            return self._light(drive, self._ambient)
        return self._seen.run(light=self.light(drive), base=self._ambient, **self._mixer.seen_rows)

    def light(self, drive: Light) -> Light:
        """S p + U M D p."""
        return self._light(drive, self._black)

    def _light(self, drive: Light, base: Light) -> Light:
        near = self._near.run(drive, base)
        return near if self._far is None else self._far.run(drive, near)

    def release(self) -> None:
        self._owner.release()


class MapViews:
    """The views that are maps, and the map of what clips over others (views.py). Each is built when first asked.

    stored, ambient, mixer : as an Observer has them.
    """

    def __init__(self, device: Device, stored: StoredMaps, ambient: Light, mixer: Mixer) -> None:
        self._device, self._stored, self._ambient, self._mixer = device, stored, ambient, mixer
        self._owner, self._room = Owner(), stored.room
        self._camera, self._projector = self._room.calibration.camera.shape, self._room.calibration.projector.shape

    @cached_property
    def reach(self) -> Light:
        """The brightest grey that each primary lets a pixel show, and in alpha whether it counts."""
        temporary, mixer = Owner(), self._mixer
        unlimited = {"unlimited": UNLIMITED} if mixer.mixes else {}
        reach = self._owner.own(self._device.make_pass("reach.frag", self._camera, mixer.defines, **unlimited))
        try:
            observer = temporary.own(Observer(self._device, self._stored, self._ambient, mixer))
            seen_of = observer.light if mixer.mixes else observer.run
            return self._full_drive(seen_of, self._ambient, reach, mixer.rows if mixer.mixes else {})
        finally:
            temporary.release()

    @cached_property
    def full(self) -> Light:
        """T·1, the light of full drive, and in alpha the mask."""
        temporary = Owner()
        reach = self._owner.own(self._device.make_pass("reach.frag", self._camera, {"ABOVE": None}))
        try:
            observer = temporary.own(Observer(self._device, self._stored, self._ambient, self._mixer))
            black = temporary.own(self._device.picture(np.zeros((*self._camera, 3), np.float32)))
            return self._full_drive(observer.light, black, reach, {})
        finally:
            temporary.release()

    @cached_property
    def most(self) -> Light:
        """S·1, the near light of full drive, and in alpha whether a camera pixel counts."""
        temporary = Owner()
        reach = self._owner.own(self._device.make_pass("reach.frag", self._camera))
        try:
            black = temporary.own(self._device.picture(np.zeros((*self._camera, 3), np.float32)))
            product = temporary.own(self._stored.of(self._room.maps.transport).product())
            return self._full_drive(product.run, black, reach, {})
        finally:
            temporary.release()

    def _full_drive(
        self, seen_of: Callable[[Light], Light], ambient: Light, reach: Pass, rows: Mapping[str, Light]
    ) -> Light:
        temporary = Owner()
        try:
            white = temporary.own(self._device.picture(np.ones((*self._projector, 3), np.float32)))
            mask = temporary.own(self._device.mask(self._room.calibration.mask))
            return reach.run(seen=seen_of(white), ambient=ambient, mask=mask, **rows)
        finally:
            temporary.release()

    def error(self, seen: Light, b: Light) -> Light:
        wanted, colours = self._mixer.on_screen(b), self._error_colours
        return self._error.run(seen=seen, b=wanted, ambient=self._ambient, reach=self.reach, colours=colours)

    def impossible(self) -> Light:
        return self._impossible.run(reach=self.reach, colours=self._impossible_colours)

    def over_camera(self, view: Light, near_light: Light) -> Light:
        """near_light : of what is asked for."""
        return self._over_camera.run(view=view, asked=near_light, most=self.most)

    def over_projector(self, view: Light, product: Light) -> Light:
        """product : T⁺ b, not clamped."""
        return self._over_projector.run(view=view, asked=product)

    def release(self) -> None:
        self._owner.release()

    @cached_property
    def _error(self) -> Pass:
        white = self._room.white
        return self._owner.own(
            self._device.make_pass("error_map.frag", self._camera, white=white, span=ERROR_SPAN, uncounted=UNCOUNTED)
        )

    @cached_property
    def _error_colours(self) -> Light:
        return self._owner.own(self._device.picture(error_colours()[None]))

    @cached_property
    def _impossible(self) -> Pass:
        white, make_pass = self._room.white, self._device.make_pass
        return self._owner.own(
            make_pass("impossible.frag", self._camera, white=white, mid_grey=MID_GREY * white, slack=SLACK)
        )

    @cached_property
    def _impossible_colours(self) -> Light:
        return self._owner.own(self._device.picture(IMPOSSIBLE[None]))

    @cached_property
    def _over_camera(self) -> Pass:
        return self._clipping(self._camera, self._room.white, {"MOST": None})

    @cached_property
    def _over_projector(self) -> Pass:
        return self._clipping(self._projector, 1.0, {})

    def _clipping(self, shape: tuple[int, int], white: float, defines: dict[str, int | None]) -> Pass:
        colours = {"above": OVER, "below": UNDER}
        shares = {"white": white, "faint": CLIP_FAINT, "full": CLIP_SPAN}
        return self._owner.own(self._device.make_pass("clipping.frag", shape, defines, **shares, **colours))

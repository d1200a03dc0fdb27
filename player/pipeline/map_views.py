"""From drives to what is shown: the camera's prediction, and the maps over and instead of it."""

from functools import cached_property

import numpy as np

from counterlight.pipeline.device import Device, FarPass, Light, Operation, Owner, Pass, StoredMaps
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
    """What the camera sees of a drive: e + S p + U M D p."""

    def __init__(self, stored: StoredMaps, ambient: Light) -> None:
        maps = stored.room.maps
        self._near = stored.of(maps.transport).product("ADD_TO_BASE")
        self._far = None if maps.far is None else FarPass(stored, maps.far, "ADD_TO_BASE")
        self._ambient = ambient

    def run(self, drive: Light) -> Light:
        near = self._near.run(drive, self._ambient)
        return near if self._far is None else self._far.run(drive, near)

    def release(self) -> None:
        self._near.release()
        if self._far is not None:
            self._far.release()


class MapViews:
    """The views that are maps, and the map of what clips over others (views.py). Each is built when first asked.

    stored, ambient : as an Observer has them.
    """

    def __init__(self, device: Device, stored: StoredMaps, ambient: Light) -> None:
        self._device, self._stored, self._ambient, self._owner = device, stored, ambient, Owner()
        self._room = stored.room
        self._camera, self._projector = self._room.calibration.camera.shape, self._room.calibration.projector.shape

    @cached_property
    def reach(self) -> Light:
        """e + T·1, and in alpha whether a camera pixel counts."""
        return self._full_drive(Observer(self._stored, self._ambient), self._ambient)

    @cached_property
    def most(self) -> Light:
        """S·1, the near light of full drive, and in alpha whether a camera pixel counts."""
        temporary = Owner()
        black = temporary.own(self._device.picture(np.zeros((*self._camera, 3), np.float32)))
        try:
            return self._full_drive(self._stored.of(self._room.maps.transport).product(), black)
        finally:
            temporary.release()

    def _full_drive(self, seen_of: Observer | Operation, ambient: Light) -> Light:
        device, temporary = self._device, Owner()
        reach = self._owner.own(device.make_pass("reach.frag", self._camera))
        try:
            temporary.own(seen_of)
            white = temporary.own(device.picture(np.ones((*self._projector, 3), np.float32)))
            mask = temporary.own(device.mask(self._room.calibration.mask))
            return reach.run(seen=seen_of.run(white), ambient=ambient, mask=mask)
        finally:
            temporary.release()

    def error(self, seen: Light, b: Light) -> Light:
        colours = self._error_colours
        return self._error.run(seen=seen, b=b, ambient=self._ambient, reach=self.reach, colours=colours)

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

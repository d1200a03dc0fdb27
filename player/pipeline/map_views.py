"""From drives to shown pictures: the predicted camera picture, and the maps drawn over it or instead of it."""

from collections.abc import Callable, Mapping
from functools import cached_property

import numpy as np

from counterlight.maps.mixing import UNLIMITED
from counterlight.pipeline.device import ChainPass, Device, Light, Owner, Pass, StoredMaps
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
    """Predicts the camera picture of a drive, in screen primaries: e + B T p.

    far : whether far light is included.
    """

    def __init__(self, stored: StoredMaps, ambient: Light, mixer: Mixer, *, far: bool = True) -> None:
        maps, self._owner = stored.room.maps, Owner()
        own = self._owner.own
        self._near = own(stored.of(maps.transport).product("ADD_TO_BASE"))
        chains = [chain for chain in maps.chains if far or chain is not maps.far]
        self._chains = [own(ChainPass(stored, chain, "ADD_TO_BASE")) for chain in chains]
        self._ambient, self._mixer = ambient, mixer
        if mixer.mixes:
            self._seen = own(mixer.seen())

    def run(self, drive: Light) -> Light:
        if not self._mixer.mixes:
            return self._light(drive, self._ambient)
        return self._seen.run(light=self.light(drive), base=self._ambient, **self._mixer.seen_rows)

    def light(self, drive: Light) -> Light:
        """Return T p."""
        return self._light(drive, self._mixer.black)

    def _light(self, drive: Light, base: Light) -> Light:
        light = self._near.run(drive, base)
        for chain in self._chains:
            light = chain.run(drive, light)
        return light

    def release(self) -> None:
        self._owner.release()


class MapViews:
    """The views that are maps, and the map of clipping over other views (views.py). Each is built on first use.

    stored, ambient, mixer : as in Observer.
    """

    def __init__(self, device: Device, stored: StoredMaps, ambient: Light, mixer: Mixer) -> None:
        self._device, self._stored, self._ambient, self._mixer = device, stored, ambient, mixer
        self._owner, self._room = Owner(), stored.room
        self._camera, self._projector = self._room.calibration.camera.shape, self._room.calibration.projector.shape

    @cached_property
    def reach(self) -> Light:
        """The brightest grey that each primary allows a pixel; alpha says whether the pixel counts."""
        observer, mixer = self._observer(), self._mixer
        if not mixer.mixes:
            return self._full_drive(observer, observer.run, self._ambient)
        return self._full_drive(observer, observer.light, self._ambient, mixer.defines, UNLIMITED, **mixer.rows)

    @cached_property
    def full(self) -> Light:
        """T·1, the light of full drive."""
        observer = self._observer()
        return self._full_drive(observer, observer.light, self._mixer.black, {"ABOVE": None})

    @cached_property
    def most(self) -> Light:
        """(S + B P)·1, the light of full drive without far light; alpha says whether a camera pixel counts."""
        observer = Observer(self._stored, self._ambient, self._mixer, far=False)
        return self._full_drive(observer, observer.light, self._mixer.black)

    def _observer(self) -> Observer:
        return Observer(self._stored, self._ambient, self._mixer)

    def _full_drive(
        self,
        made: Observer,
        see: Callable[[Light], Light],
        ambient: Light,
        defines: Mapping[str, int | None] | None = None,
        unlimited: float | None = None,
        **rows: Light,
    ) -> Light:
        """Run reach.frag on `see(full drive)`; then release `made`, the observer behind `see`."""
        temporary = Owner()
        try:
            temporary.own(made)
            uniforms = {} if unlimited is None else {"unlimited": unlimited}
            reach = self._owner.own(self._device.make_pass("reach.frag", self._camera, defines, **uniforms))
            white = temporary.own(self._device.picture(np.ones((*self._projector, 3), np.float32)))
            mask = temporary.own(self._device.mask(self._room.calibration.mask))
            return reach.run(seen=see(white), ambient=ambient, mask=mask, **rows)
        finally:
            temporary.release()

    def error(self, seen: Light, b: Light) -> Light:
        wanted, colours = self._mixer.on_screen(b), self._error_colours
        return self._error.run(seen=seen, b=wanted, ambient=self._ambient, reach=self.reach, colours=colours)

    def impossible(self) -> Light:
        return self._impossible.run(reach=self.reach, colours=self._impossible_colours)

    def over_camera(self, view: Light, near_light: Light) -> Light:
        """Draw clipping over a camera view. near_light : near light of the target."""
        return self._over_camera.run(view=view, asked=near_light, most=self.most)

    def over_projector(self, view: Light, product: Light) -> Light:
        """Draw clipping over the projector view. product : T⁺ b, not clamped."""
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

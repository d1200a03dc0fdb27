"""From drives to what is shown: the camera's prediction, the maps over and instead of it, and 8-bit codes."""

from functools import cached_property

import moderngl
import numpy as np

from counterlight.gl.passes import Owner, Pass, Uniform, float_texture, integer_texture, picture_texture, table_texture
from counterlight.gl.paths import Chain, FarPass, Product, StoredMap
from counterlight.response import Response
from counterlight.room import Room
from counterlight.views import (
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

    def __init__(self, transport: StoredMap, far: Chain | None, ambient: moderngl.Texture) -> None:
        self._near = transport.product("ADD_TO_BASE")
        self._far = None if far is None else FarPass(far, "ADD_TO_BASE")
        self._ambient = ambient

    def run(self, drive: moderngl.Texture) -> moderngl.Texture:
        near = self._near.run(drive, self._ambient)
        return near if self._far is None else self._far.run(drive, near)

    def release(self) -> None:
        self._near.release()
        if self._far is not None:
            self._far.release()


class Maps:
    """The views that are maps, and the map of what clips over others (player/views.py). Each is built when first asked.

    transport, far, ambient : as an Observer has them.
    """

    def __init__(
        self,
        context: moderngl.Context,
        room: Room,
        transport: StoredMap,
        far: Chain | None,
        ambient: moderngl.Texture,
    ) -> None:
        self._context, self._room, self._owner = context, room, Owner()
        self._transport, self._far, self._ambient = transport, far, ambient
        self._camera, self._projector = room.calibration.camera.shape, room.calibration.projector.shape

    @cached_property
    def reach(self) -> moderngl.Texture:
        """e + T·1, and in alpha whether a camera pixel counts."""
        return self._full_drive(Observer(self._transport, self._far, self._ambient), self._ambient)

    @cached_property
    def most(self) -> moderngl.Texture:
        """S·1, the near light of full drive, and in alpha whether a camera pixel counts."""
        black = picture_texture(self._context, np.zeros((*self._camera, 3), np.float32))
        try:
            return self._full_drive(self._transport.product(), black)
        finally:
            black.release()

    def _full_drive(self, seen_of: Observer | Product, ambient: moderngl.Texture) -> moderngl.Texture:
        context, temporary = self._context, Owner()
        reach = self._owner.own(Pass(context, "reach.frag", float_texture(context, self._camera)))
        try:
            temporary.own(seen_of)
            white = temporary.own(picture_texture(context, np.ones((*self._projector, 3), np.float32)))
            mask = temporary.own(integer_texture(context, self._room.calibration.mask.astype(np.uint32)))
            return reach.run(seen=seen_of.run(white), ambient=ambient, mask=mask)
        finally:
            temporary.release()

    def error(self, seen: moderngl.Texture, b: moderngl.Texture) -> moderngl.Texture:
        colours = self._error_colours
        return self._error.run(seen=seen, b=b, ambient=self._ambient, reach=self.reach, colours=colours)

    def impossible(self) -> moderngl.Texture:
        return self._impossible.run(reach=self.reach, colours=self._impossible_colours)

    def over_camera(self, view: moderngl.Texture, near_light: moderngl.Texture) -> moderngl.Texture:
        """near_light : of what is asked for."""
        return self._over_camera.run(view=view, asked=near_light, most=self.most)

    def over_projector(self, view: moderngl.Texture, product: moderngl.Texture) -> moderngl.Texture:
        """product : T⁺ b, not clamped."""
        return self._over_projector.run(view=view, asked=product)

    def release(self) -> None:
        self._owner.release()

    @cached_property
    def _error(self) -> Pass:
        uniforms: dict[str, Uniform] = {"white": self._room.white, "span": ERROR_SPAN, "uncounted": tuple(UNCOUNTED)}
        return self._owner.own(
            Pass(self._context, "error_map.frag", float_texture(self._context, self._camera), None, **uniforms)
        )

    @cached_property
    def _error_colours(self) -> moderngl.Texture:
        return self._owner.own(_colours(self._context, error_colours()))

    @cached_property
    def _impossible(self) -> Pass:
        white, target = self._room.white, float_texture(self._context, self._camera)
        uniforms: dict[str, Uniform] = {"white": white, "mid_grey": MID_GREY * white, "slack": SLACK}
        return self._owner.own(Pass(self._context, "impossible.frag", target, None, **uniforms))

    @cached_property
    def _impossible_colours(self) -> moderngl.Texture:
        return self._owner.own(_colours(self._context, IMPOSSIBLE))

    @cached_property
    def _over_camera(self) -> Pass:
        return self._owner.own(_clipping(self._context, self._camera, self._room.white, {"MOST": None}))

    @cached_property
    def _over_projector(self) -> Pass:
        return self._owner.own(_clipping(self._context, self._projector, 1.0, {}))


class Encoder:
    """Linear light to 8 bit through an inverse response."""

    def __init__(
        self, context: moderngl.Context, shape: tuple[int, int], response: Response, scale: float, dither: str
    ) -> None:
        defines: dict[str, int | None] = {} if dither == "none" else {f"DITHER_{dither.upper()}": None}
        target = context.texture((shape[1], shape[0]), 4, dtype="f1")
        self._table = table_texture(context, response.inverse_table())
        self._pass = Pass(context, "encode.frag", target, defines, scale=scale)
        self._noisy = dither == "noise"

    def run(self, light: moderngl.Texture, frame: int) -> moderngl.Texture:
        if self._noisy:
            self._pass.set(frame=frame & 0xFFFFFFFF)
        return self._pass.run(picture=light, inverse_response=self._table)

    def release(self) -> None:
        self._pass.release()
        self._table.release()


def _colours(context: moderngl.Context, table: np.ndarray) -> moderngl.Texture:
    return picture_texture(context, table[None].astype(np.float32))


def _clipping(context: moderngl.Context, shape: tuple[int, int], white: float, defines: dict[str, int | None]) -> Pass:
    uniforms: dict[str, Uniform] = {"white": white, "faint": CLIP_FAINT, "full": CLIP_SPAN}
    uniforms |= {"above": tuple(OVER), "below": tuple(UNDER)}
    return Pass(context, "clipping.frag", float_texture(context, shape), defines, **uniforms)

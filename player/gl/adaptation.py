"""Computes the scale and offset that adapt a frame to the room.

Sums over the camera's view are computed in tiles and then added; nothing is read back.
"""

from collections.abc import Callable, Mapping

import moderngl
import numpy as np

from counterlight.gl.passes import Canvas, ShaderPass, Uniform, float_texture, picture_texture, table_texture
from counterlight.passes.adaptation import CHOICE_SHADER, OFFSETS, PERCENT, SCALES, SUMS_SHADER, TILES, tile_grid
from counterlight.passes.certificate import BlockSum
from counterlight.passes.combine import Combine
from counterlight.passes.desired import Desired, Tone
from counterlight.pipeline.content import Succession, approach
from counterlight.pipeline.device import NearLight, Owner, Owning


class Adapter(Owning):
    """Computes (s, o) of a frame (player/pipeline/content.py) into a texture of one texel.

    near_light : u -> u − F u.
    ambient, most : radiance textures of the camera's size; see shaders/clip_sums.frag.
    """

    def __init__(
        self,
        context: moderngl.Context,
        canvas: Callable[[tuple[int, int]], Canvas],
        near_light: NearLight[moderngl.Texture],
        ambient: moderngl.Texture,
        most: moderngl.Texture,
        white: float,
    ) -> None:
        self._owner, self._succession, self._near_light = Owner(), Succession(lasting=True), near_light
        own, shape = self._owner.own, (ambient.height, ambient.width)
        self._no_tone = own(picture_texture(context, np.array([[[1, 0, 0]]], np.float32)))
        self._black = own(picture_texture(context, np.zeros((*shape, 3), np.float32)))
        self._shares = own(canvas(shape))
        ones = own(picture_texture(context, np.ones((*shape, 3), np.float32)))
        limits = {"ambient": ambient, "most": most}
        for name, light in (("near_white", ones), ("near_ambient", ambient)):
            limits[name] = own(canvas(shape)).draw(Combine(near_light(light), self._black, 0.0))
        self._offset_sums, self._scale_sums = (
            own(_Sums(context, canvas, shape, limits, white, each)) for each in ("OFFSETS", "SCALES")
        )
        self._offset = own(ShaderPass(context, CHOICE_SHADER, float_texture(context, (1, 1))))
        self._before, self._now = (
            own(ShaderPass(context, CHOICE_SHADER, float_texture(context, (1, 1)), {"SCALES": None})) for _ in range(2)
        )
        self._before.clear()

    def set(self, adapt: float, unit: float, black_level: float) -> None:
        """Set the parameters of the adaptation.

        adapt : percent of the light that may be clipped.
        unit : share of white that a picture's 1 stands for.
        black_level : share of white that black stands for.
        """
        self._tone = Tone(self._no_tone, unit, black_level)
        self._offset_sums.set(budget=adapt * PERCENT / 2)
        self._scale_sums.set(budget=adapt * PERCENT)
        self._succession.restart()

    def advance(self, *, cut: bool, duration_s: float) -> None:
        if self._succession.advance(cut=cut, duration_s=duration_s):
            self._before, self._now = self._now, self._before

    def run(self, placed: moderngl.Texture) -> moderngl.Texture:
        u = self._shares.draw(Desired(placed, self._black, 1.0, self._tone))
        near = self._near_light(u)
        offset = self._offset.run(sums=self._offset_sums.run(u, near), candidates=self._offset_sums.candidates)
        sums = self._scale_sums.run(u, near, tone=offset)
        self._now.set(approach=1.0 if self._succession.fresh else approach(self._succession.elapsed_s))
        self._succession.draw()
        return self._now.run(sums=sums, candidates=self._scale_sums.candidates, tone=offset, before=self._before.target)


class _Sums(Owning):
    """Computes the sums of 16 candidates, OFFSETS or SCALES, into four texels."""

    def __init__(
        self,
        context: moderngl.Context,
        canvas: Callable[[tuple[int, int]], Canvas],
        shape: tuple[int, int],
        limits: Mapping[str, moderngl.Texture],
        white: float,
        which: str,
    ) -> None:
        self._owner, self._limits = Owner(), limits
        own, scales = self._owner.own, which == "SCALES"
        values = (SCALES if scales else OFFSETS).astype(np.float32)
        self.candidates = own(table_texture(context, values))
        defines: dict[str, int | None] = {"TILES": TILES} | ({"SCALES": None} if scales else {})
        tile, stride = tile_grid(shape)
        tiles = float_texture(context, (4 * TILES, TILES))
        uniforms: dict[str, Uniform] = {"tile": tile[::-1], "stride": stride[::-1], "white": white}
        self._tiles = own(ShaderPass(context, SUMS_SHADER, tiles, defines, **uniforms))
        self._all = own(canvas((4, 1)))

    def set(self, *, budget: float) -> None:
        self._tiles.set(budget=budget)

    def run(self, u: moderngl.Texture, near: moderngl.Texture, **tone: moderngl.Texture) -> moderngl.Texture:
        tiles = self._tiles.run(picture=u, near=near, candidates=self.candidates, **self._limits, **tone)
        return self._all.draw(BlockSum(tiles, TILES))

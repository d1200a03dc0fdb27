"""The pipeline's device for OpenGL; see counterlight.pipeline.device."""

from collections.abc import Sequence
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from counterlight.gl.adaptation import Adapter
from counterlight.gl.passes import (
    Canvas,
    Programs,
    ShaderPass,
    float_texture,
    integer_texture,
    picture_texture,
)
from counterlight.gl.paths import GlMaps, store_maps
from counterlight.gl.planes import Planes
from counterlight.media.frames import PixelFormat
from counterlight.passes import encode
from counterlight.passes.certificate import BlockSum
from counterlight.passes.drawing import CHANNELS
from counterlight.passes.refinement_step import Step, Ties
from counterlight.pipeline.device import EVERYWHERE, GpuPath, NearLight, Owner, Owning
from counterlight.pipeline.refinement import OVER_RELAXATION, momentum
from counterlight.pipeline.room import Room
from counterlight.processing import CELLS
from counterlight.response import RasterResponse

BLOCK = 16
CODES = {8: 0x8058, 10: 0x8059}  # OpenGL's internal formats RGBA8 and RGB10_A2 by bits


class GlDevice:
    """Makes pictures as RGBA32F textures. The caller owns the context.

    path : how to multiply with a room's maps.
    bits : bits per encoded code value, 8 or 10.
    """

    def __init__(self, context: moderngl.Context, path: GpuPath = EVERYWHERE, bits: int = 8) -> None:
        self._context, self._path, self._bits, self._programs = context, path, bits, Programs(context)

    def picture(self, picture: NDArray[np.floating]) -> moderngl.Texture:
        return picture_texture(self._context, picture.astype(np.float32, copy=False))

    def write(self, light: moderngl.Texture, picture: NDArray[np.floating]) -> None:
        light.write(np.concatenate([picture, np.ones((*picture.shape[:2], 1))], axis=2).astype(np.float32))

    def mask(self, mask: NDArray[np.bool_]) -> moderngl.Texture:
        return integer_texture(self._context, mask.astype(np.uint32))

    def canvas(self, shape: tuple[int, int], channels: int = CHANNELS) -> Canvas:
        """Return a canvas; textures always have four channels."""
        return Canvas(self._context, self._programs, float_texture(self._context, shape))

    def store(self, room: Room) -> GlMaps:
        return store_maps(self._context, room, self._path)

    def planes(self, pixels: PixelFormat) -> Planes:
        return Planes(self._context, pixels)

    def adapter(
        self, near_light: NearLight[moderngl.Texture], ambient: moderngl.Texture, most: moderngl.Texture, white: float
    ) -> Adapter:
        return Adapter(self._context, self.canvas, near_light, ambient, most, white)

    def encoder(self, shape: tuple[int, int], response: RasterResponse, scale: float, dither: str) -> "_Encoder":
        return _Encoder(self._context, shape, response, scale, dither, self._bits)

    def stepper(self, shape: tuple[int, int], prior: Ties[moderngl.Texture]) -> "_Stepper":
        self._programs.prepare(Step)
        owner = Owner()
        with owner:
            return _Stepper(owner, [owner.own(self._pair(shape)) for _ in range(2)], prior)

    def _pair(self, shape: tuple[int, int]) -> Canvas:
        """Return a canvas of two pictures."""
        made = Owner()
        with made:
            first, second = (made.own(float_texture(self._context, shape)) for _ in range(2))
        return Canvas(self._context, self._programs, first, second)

    def total(self, shape: tuple[int, int]) -> "_Total":
        return _Total(self, shape)

    def read(self, light: moderngl.Texture, dtype: type) -> NDArray[Any]:
        width, height = light.size
        return np.frombuffer(light.read(), dtype).reshape(height, width, 4)[..., :3]

    def finish(self) -> None:
        self._context.finish()

    def release(self) -> None:
        """Release the programs; the caller's pictures stay."""
        self._programs.release()


class _Encoder(Owning):
    """The pass encode.frag with its tables."""

    def __init__(
        self,
        context: moderngl.Context,
        shape: tuple[int, int],
        response: RasterResponse,
        scale: float,
        dither: str,
        bits: int,
    ) -> None:
        self._owner, self._noisy = Owner(), dither == "noise"
        own, defines = self._owner.own, dict[str, int | None]()
        if dither != "none":
            defines[f"DITHER_{dither.upper()}"] = None
        with self._owner:
            self._inputs = {"inverse_response": own(picture_texture(context, response.inverse_tables()))}
            if response.of_column.any():
                defines["SEVERAL"] = response.row_height
                self._inputs["of_column"] = own(integer_texture(context, response.of_column.astype(np.uint32)))
            if response.matrices is not None:
                defines["MIXED"] = None
                self._inputs["colours"] = own(picture_texture(context, response.matrices))
            segments = response.segment_tables()
            if segments is not None:
                defines["SEGMENT"] = None
                self._inputs["segments"] = own(picture_texture(context, segments.reshape(-1, *segments.shape[2:])))
            tables = response.processing_tables
            if tables is not None:
                defines["PROCESSED"] = CELLS
                rows = tables.reshape(-1, CELLS, 3)  # one row of texels for each projector, red and green
                self._inputs["processing"] = own(picture_texture(context, rows))
            target = context.texture((shape[1], shape[0]), 4, dtype="f1", internal_format=CODES[bits])
            self._pass = own(ShaderPass(context, encode.SHADER, target, defines, scale=scale, highest=2**bits - 1))

    def run(self, light: moderngl.Texture, frame: int) -> moderngl.Texture:
        if self._noisy:
            self._pass.set(frame=frame & 0xFFFFFFFF)
        return self._pass.run(picture=light, **self._inputs)


class _Stepper(Owning):
    """The pass refinement_step, alternating between two pairs of pictures."""

    def __init__(self, owner: Owner, canvases: Sequence[Canvas], prior: Ties[moderngl.Texture]) -> None:
        self._owner, self._canvases, self._prior = owner, canvases, prior

    def run(
        self,
        step: int,
        descent: moderngl.Texture,
        y: moderngl.Texture,
        p: moderngl.Texture,
        step_size: moderngl.Texture,
    ) -> tuple[moderngl.Texture, moderngl.Texture]:
        following = self._canvases[step % 2]
        following.draw(Step(descent, y, p, step_size, self._prior, momentum(step), OVER_RELAXATION))
        return following.pictures[0], following.pictures[1]


class _Total:
    """Sums a picture to one pixel, block by block."""

    def __init__(self, device: GlDevice, shape: tuple[int, int]) -> None:
        self._canvases: list[Canvas] = []
        while shape != (1, 1):
            shape = -(-shape[0] // BLOCK), -(-shape[1] // BLOCK)
            self._canvases.append(device.canvas(shape))

    def run(self, picture: moderngl.Texture) -> NDArray[np.float64]:
        for canvas in self._canvases:
            picture = canvas.draw(BlockSum(picture, BLOCK))
        return np.frombuffer(picture.read(), np.float32)[:3].astype(np.float64)

    def release(self) -> None:
        for canvas in self._canvases:
            canvas.release()

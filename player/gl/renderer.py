"""Renderers for windows: on a GPU (OpenGL 3.3, or 4.3 where it is faster), or on the processor, shown by OpenGL."""

from abc import abstractmethod

import moderngl
import numpy as np

from counterlight.gl.device import GlDevice
from counterlight.passes.drawing import Array, Picture
from counterlight.pipeline.cpu_renderer import CpuDevice
from counterlight.pipeline.device import EVERYWHERE, GpuPath
from counterlight.pipeline.renderer import Renderer
from counterlight.pipeline.room import Room


class WindowRenderer(Renderer[Picture]):
    """A renderer whose view a window can show. The caller owns the window's context."""

    @property
    @abstractmethod
    def encoded_texture(self) -> moderngl.Texture:
        """The rendered view, row 0 at the top."""


class GlRenderer(WindowRenderer[moderngl.Texture]):
    """The renderer on a GPU. bits : 8 or 10 bits per code value, as the window has; `encoded` always has 8."""

    def __init__(self, context: moderngl.Context, room: Room, path: GpuPath = EVERYWHERE, bits: int = 8) -> None:
        super().__init__(GlDevice(context, path, bits), room)

    @property
    def encoded_texture(self) -> moderngl.Texture:
        """RGBA8 or RGB10_A2."""
        return self._encoded


class ComputedRenderer(WindowRenderer[Array]):
    """Renders 8-bit code values, whatever the window's depth."""

    def __init__(self, context: moderngl.Context, room: Room) -> None:
        self._context = context
        self._textures: dict[tuple[int, ...], moderngl.Texture] = {}
        super().__init__(CpuDevice(), room)

    def render(self, view: str, *, compensate: bool, frame: int = 0, steps: int = 0, timed: bool = False) -> None:
        super().render(view, compensate=compensate, frame=frame, steps=steps, timed=timed)
        codes = self.encoded()
        if codes.shape not in self._textures:
            height, width, channels = codes.shape
            made = self._context.texture((width, height), channels, alignment=1, dtype="f1")
            self._textures[codes.shape] = self._owner.own(made)
        self._texture = self._textures[codes.shape]
        self._texture.write(np.ascontiguousarray(codes))

    @property
    def encoded_texture(self) -> moderngl.Texture:
        """RGB8 texture of the projector's view or the camera's view."""
        return self._texture

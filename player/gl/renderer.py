"""The GPU backend: the pipeline of renderer.py over OpenGL 3.3, or 4.3 where it is faster."""

from abc import abstractmethod

import moderngl

from counterlight.gl.device import GlDevice
from counterlight.passes.drawing import Picture
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

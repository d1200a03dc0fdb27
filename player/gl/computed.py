"""Windows without GPU computation: pipeline/cpu_renderer.py makes the picture, and OpenGL only shows it."""

import moderngl
import numpy as np

from counterlight.gl.renderer import WindowRenderer
from counterlight.passes.drawing import Array
from counterlight.pipeline.cpu_renderer import CpuDevice
from counterlight.pipeline.room import Room


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

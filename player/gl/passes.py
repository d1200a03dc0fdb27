"""One full-screen pass: a program, the textures it reads, the texture it writes. Built once, run every frame."""

from collections.abc import Mapping
from typing import Any, TypeAlias

import moderngl
import numpy as np
from numpy.typing import NDArray

from player.errors import InputError
from player.gl.shaders import build_program

Uniform: TypeAlias = float | int | tuple[float, ...] | tuple[int, ...]
FLOAT_COMPONENTS = 4  # three-component float textures need not be renderable


def float_texture(context: moderngl.Context, shape: tuple[int, int], data: NDArray[np.float32] | None = None) -> Any:
    """An RGBA32F texture (height, width) for data: nearest texel, no wrapping. Raises InputError if it cannot exist."""
    return _texture(context, shape, FLOAT_COMPONENTS, "f4", data)


def table_texture(context: moderngl.Context, table: NDArray[np.float32]) -> moderngl.Texture:
    """A table (samples,) or (samples, channels) as a texture of height 1."""
    columns = table[:, None] if table.ndim == 1 else table
    return _texture(context, (1, len(columns)), columns.shape[1], "f4", np.ascontiguousarray(columns))


def integer_texture(context: moderngl.Context, data: NDArray[np.uint32]) -> moderngl.Texture:
    """Unsigned integers (height, width) or (height, width, channels)."""
    components = 1 if data.ndim == 2 else data.shape[2]
    return _texture(context, (data.shape[0], data.shape[1]), components, "u4", data)


def plane_texture(context: moderngl.Context, shape: tuple[int, int], dtype: np.dtype[Any]) -> moderngl.Texture:
    """A plane of samples: unsigned 8 or 16 bit integers, or float32."""
    return _texture(context, shape, 1, {"uint8": "u1", "uint16": "u2", "float32": "f4"}[dtype.name], None)


def _texture(
    context: moderngl.Context, shape: tuple[int, int], components: int, dtype: str, data: NDArray[Any] | None
) -> moderngl.Texture:
    limit = context.info["GL_MAX_TEXTURE_SIZE"]
    height, width = shape
    if max(shape) > limit:
        raise InputError(
            f"this GPU's textures end at {limit}x{limit} texels, {width}x{height} are needed; "
            "build a smaller map with a larger --max-error, or play with --backend cpu"
        )
    alignment = 4 if dtype in ("f4", "u4") else 1
    texture = context.texture((width, height), components, data, alignment=alignment, dtype=dtype)
    texture.filter = moderngl.NEAREST, moderngl.NEAREST
    texture.repeat_x = texture.repeat_y = False
    if context.error != "GL_NO_ERROR":  # moderngl raises nothing when memory runs out
        texture.release()
        raise InputError(
            f"the GPU has no memory for a {width}x{height} texture; build a smaller map with a larger --max-error, "
            "or play with --backend cpu"
        )
    return texture


class Pass:
    """Draws one fragment shader into its own target.

    target : the texture it writes, released with the pass; None to draw into whatever framebuffer is in use.
    """

    def __init__(
        self,
        context: moderngl.Context,
        shader: str,
        target: moderngl.Texture | None,
        defines: Mapping[str, int | None] | None = None,
        **uniforms: Uniform,
    ) -> None:
        self._context = context
        self._program = build_program(context, shader, defines)
        self._triangle = context.vertex_array(self._program, [])
        self._triangle.vertices = 3
        self._framebuffer = None if target is None else context.framebuffer([target])
        self._inputs: dict[str, int] = {}
        self.target = target
        self.set(**uniforms)

    def set(self, **uniforms: Uniform) -> None:
        """Set uniforms by name; names that the shader does not use on this path are an error."""
        for name, value in uniforms.items():
            self._program[name] = value

    def run(self, **inputs: moderngl.Texture) -> moderngl.Texture | None:
        """Draw with the given textures; returns the target."""
        for name, texture in inputs.items():
            texture.use(self._unit(name))
        if self._framebuffer is not None:
            self._framebuffer.use()
        self._triangle.render(moderngl.TRIANGLES)
        return self.target

    def _unit(self, name: str) -> int:
        """The texture unit of a sampler, given out at its first use."""
        if name not in self._inputs:
            self._inputs[name] = len(self._inputs)
            self._program[name] = self._inputs[name]
        return self._inputs[name]

    def release(self) -> None:
        for resource in (self._triangle, self._program, self._framebuffer, self.target):
            if resource is not None:
                resource.release()

"""Draws fragment shaders: into the current framebuffer, or as passes (counterlight.passes) into canvases."""

from collections.abc import Mapping
from dataclasses import is_dataclass
from typing import Any, TypeAlias

import moderngl
import numpy as np
from numpy.typing import NDArray

from counterlight.errors import InputError
from counterlight.gl.shaders import build_program
from counterlight.passes.drawing import Draw, inputs_of

Uniform: TypeAlias = float | int | tuple[float, ...] | tuple[int, ...]
# texels converted to RGBA at a time; allocating a whole picture would take as long as copying it
STRIP_TEXELS = 1 << 16
FLOAT_COMPONENTS = 4  # RGBA, because OpenGL need not draw into float textures of three components


def float_texture(
    context: moderngl.Context, shape: tuple[int, int], data: NDArray[np.float32] | None = None
) -> moderngl.Texture:
    """Return an RGBA32F data texture (height, width), nearest texel, no wrapping. Raises InputError if this fails."""
    return _texture(context, shape, FLOAT_COMPONENTS, "f4", data)


def picture_texture(context: moderngl.Context, picture: NDArray[np.float32]) -> moderngl.Texture:
    """Return a picture (height, width, 3) as a float texture."""
    height, width = picture.shape[:2]
    texture = float_texture(context, (height, width))
    strip = np.ones((min(max(1, STRIP_TEXELS // width), height), width, FLOAT_COMPONENTS), np.float32)
    for top in range(0, height, len(strip)):
        rows = strip[: height - top]
        rows[..., :3] = picture[top : top + len(strip)]
        texture.write(rows, (0, top, width, len(rows)))
    return texture


def table_texture(context: moderngl.Context, table: NDArray[np.float32]) -> moderngl.Texture:
    """Return a table (samples,) or (samples, channels) as a texture of height 1."""
    columns = table[:, None] if table.ndim == 1 else table
    return _texture(context, (1, len(columns)), columns.shape[1], "f4", np.ascontiguousarray(columns))


def cube_texture(context: moderngl.Context, table: NDArray[np.float32]) -> moderngl.Texture3D:
    """Return a table (size, size, size, 3), indexed by blue, green and red, for reading by texel."""
    size = len(table)
    texture = context.texture3d((size, size, size), 3, np.ascontiguousarray(table), dtype="f4")
    if context.error != "GL_NO_ERROR":
        texture.release()
        raise InputError(f"the GPU has no memory for a table of {size}³ colours; export a smaller .cube file")
    return texture


def integer_texture(context: moderngl.Context, data: NDArray[np.uint32]) -> moderngl.Texture:
    """Return a texture of unsigned integers (height, width) or (height, width, channels)."""
    components = 1 if data.ndim == 2 else data.shape[2]
    return _texture(context, (data.shape[0], data.shape[1]), components, "u4", data)


def plane_texture(context: moderngl.Context, shape: tuple[int, int], dtype: np.dtype[Any]) -> moderngl.Texture:
    """Return a texture for a plane of samples: unsigned 8 or 16 bit integers, or float32."""
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
    if context.error != "GL_NO_ERROR":  # moderngl raises nothing if memory runs out
        texture.release()
        raise InputError(
            f"the GPU has no memory for a {width}x{height} texture; build a smaller map with a larger --max-error, "
            "or play with --backend cpu"
        )
    return texture


class ScreenPass:
    """Draws one fragment shader into the current framebuffer."""

    def __init__(
        self,
        context: moderngl.Context,
        shader: str,
        defines: Mapping[str, int | None] | None = None,
        uniforms: Mapping[str, Uniform] | None = None,
    ) -> None:
        self._program = build_program(context, shader, defines)
        self._triangle = context.vertex_array(self._program, [])
        self._triangle.vertices = 3
        self._units: dict[str, int] = {}
        self.set(**(uniforms or {}))

    def set(self, **uniforms: Uniform) -> None:
        """Set uniforms by name; a name that the shader does not use is an error."""
        for name, value in uniforms.items():
            self._program[name] = value

    def draw(self, **inputs: moderngl.Texture | moderngl.Texture3D) -> None:
        """Draw with the given textures, one per sampler."""
        for name, texture in inputs.items():
            if name not in self._units:
                self._units[name] = len(self._units)
                self._program[name] = self._units[name]
            texture.use(self._units[name])
        self._triangle.render(moderngl.TRIANGLES)

    def release(self) -> None:
        self._triangle.release()
        self._program.release()


class Programs:
    """The programs of passes: each shader is compiled once per set of defines, by `prepare` or on its first draw."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._made: dict[tuple[str, frozenset[tuple[str, int | None]]], ScreenPass] = {}

    def draw(self, made: Draw[moderngl.Texture]) -> None:
        """Draw a pass into the current framebuffer."""
        defines, uniforms, textures = dict(made.defines), dict[str, Uniform](), dict[str, moderngl.Texture]()
        for name, value, optional in inputs_of(made):
            if isinstance(value, moderngl.Texture):
                textures[name] = value
            elif value is not True and not is_dataclass(value):
                uniforms[name] = tuple(value.tolist()) if isinstance(value, np.ndarray) else value
                continue
            if optional:
                defines[name.upper()] = None
        program = self._program(made.shader, defines)
        program.set(**uniforms)
        program.draw(**textures)

    def prepare(self, kind: type[Draw[moderngl.Texture]]) -> None:
        """Compile the program of a pass without optional inputs. Raises ShaderError."""
        self._program(kind.shader, kind.defines)

    def _program(self, shader: str, defines: Mapping[str, int | None]) -> ScreenPass:
        key = shader, frozenset(defines.items())
        if key not in self._made:
            self._made[key] = ScreenPass(self._context, shader, defines)
        return self._made[key]

    def release(self) -> None:
        for program in self._made.values():
            program.release()


class Canvas:
    """Owns textures that passes are drawn into together; most passes have one. The caller releases the canvas."""

    def __init__(self, context: moderngl.Context, programs: Programs, *pictures: moderngl.Texture) -> None:
        self.pictures = pictures
        self._context, self._programs = context, programs
        try:
            self._framebuffer = context.framebuffer(pictures)
        except BaseException:
            self._release_pictures()
            raise
        self.clear()

    @property
    def picture(self) -> moderngl.Texture:
        return self.pictures[0]

    def draw(self, made: Draw[moderngl.Texture]) -> moderngl.Texture:
        self._framebuffer.use()
        self._programs.draw(made)
        return self.picture

    def clear(self) -> None:
        """Make the pictures black."""
        self._framebuffer.clear()

    def release(self) -> None:
        self._context.detect_framebuffer(0).use()  # moderngl would bind the last framebuffer again later
        self._framebuffer.release()
        self._release_pictures()

    def _release_pictures(self) -> None:
        for picture in self.pictures:
            picture.release()


class ShaderPass(ScreenPass):
    """Draws one fragment shader into its own target texture."""

    def __init__(
        self,
        context: moderngl.Context,
        shader: str,
        target: moderngl.Texture,
        defines: Mapping[str, int | None] | None = None,
        **uniforms: Uniform,
    ) -> None:
        super().__init__(context, shader, defines, uniforms)
        self.target = target
        self._context = context
        self._framebuffer = context.framebuffer([target])

    def run(self, **inputs: moderngl.Texture | moderngl.Texture3D) -> moderngl.Texture:
        """Draw with the given textures; returns the target."""
        self._framebuffer.use()
        self.draw(**inputs)
        return self.target

    def clear(self) -> None:
        """Make the target black."""
        self._framebuffer.clear()

    def release(self) -> None:
        super().release()
        self._context.detect_framebuffer(0).use()  # moderngl would bind the last framebuffer again later
        self._framebuffer.release()
        self.target.release()

"""Row maps in buffers, and the compute pass that multiplies with them (shaders/row_map.comp, OpenGL 4.3)."""

from collections.abc import Mapping, Sequence
from typing import Protocol

import moderngl
import numpy as np

from counterlight.errors import InputError
from counterlight.gl.passes import float_texture
from counterlight.gl.shaders import build_compute_program
from counterlight.maps.row_map import RowMap, UintArray
from counterlight.maps.sliced_map import GROUP, Part, lanes_of, parts
from counterlight.passes.product import COMPUTE_SHADER, Combining
from counterlight.pipeline.device import LONG_BYTES, Owner

VERSION = 430
PART_ENTRIES = 1 << 23  # entries per buffer; drivers allow more, but the player arranges one part at a time
ROWS, ENTRIES, TARGET = 0, 1, 0  # bindings of the buffers, and of the image


def supports_compute(context: moderngl.Context) -> bool:
    return bool(context.version_code >= VERSION)


class MapBuffers:
    """The buffers of one row map; several passes may read them."""

    def __init__(self, context: moderngl.Context, packed: RowMap) -> None:
        self._context, self._owner = context, Owner()
        self.output_shape, self.source_shape = packed.output_shape, packed.source_shape
        self.lanes = lanes_of(packed)
        most = min(PART_ENTRIES, context.info["GL_MAX_SHADER_STORAGE_BLOCK_SIZE"] // LONG_BYTES)
        try:
            self.parts = [
                self._owner.own(PartBuffers(context, _bound(part), len(part.rows) * self.lanes // GROUP))
                for part in parts(packed, self.lanes, most)
            ]
        except BaseException:
            self.release()
            raise

    def product(self, combining: Combining = "") -> "ComputePass":
        defines: dict[str, int | None] = {"GROUP": GROUP, "LANES": self.lanes}
        if combining:
            defines[combining] = None
        return ComputePass(self._context, self, COMPUTE_SHADER, defines)

    def release(self) -> None:
        self._owner.release()


def _bound(part: Part) -> dict[int, UintArray]:
    return {ROWS: part.rows, ENTRIES: part.entries}


class PartBuffers:
    """The buffers that one dispatch of `groups` workgroups reads, by binding."""

    def __init__(self, context: moderngl.Context, bound: Mapping[int, UintArray], groups: int) -> None:
        self._owner, self.groups = Owner(), groups
        try:
            self._buffers = {binding: self._owner.own(_buffer(context, data)) for binding, data in bound.items()}
        except BaseException:
            self.release()
            raise

    def bind(self) -> None:
        for binding, buffer in self._buffers.items():
            buffer.bind_to_storage_buffer(binding)

    def release(self) -> None:
        self._owner.release()


class Buffers(Protocol):
    """A map in buffers, as a compute pass reads it."""

    @property
    def output_shape(self) -> tuple[int, int]: ...

    @property
    def parts(self) -> Sequence[PartBuffers]: ...


class ComputePass:
    """target = Σ weights · source, combined with the base as the defines say. Used like RowMapPass and SmallPass."""

    def __init__(
        self,
        context: moderngl.Context,
        buffers: Buffers,
        shader: str,
        defines: Mapping[str, int | None],
        **uniforms: float,
    ) -> None:
        self._context, self._buffers = context, buffers
        self._program = build_compute_program(context, shader, defines)
        for name, value in uniforms.items():
            self._program[name] = value
        self.target = float_texture(context, buffers.output_shape)

    def run(self, source: moderngl.Texture, base: moderngl.Texture | None = None) -> moderngl.Texture:
        inputs = {"source": source} if base is None else {"source": source, "base": base}
        for unit, (name, texture) in enumerate(inputs.items()):
            self._program[name] = unit
            texture.use(unit)
        self.target.bind_to_image(TARGET, read=False, write=True)
        for part in self._buffers.parts:
            part.bind()
            self._program.run(part.groups)
        self._context.memory_barrier()
        return self.target

    def release(self) -> None:
        self._program.release()
        self.target.release()


def _buffer(context: moderngl.Context, data: np.ndarray) -> moderngl.Buffer:
    """Return a buffer with these values; raises InputError if the GPU's memory is full."""
    buffer = context.buffer(np.ascontiguousarray(data)) if data.size else context.buffer(reserve=data.itemsize * 4)
    if context.error != "GL_NO_ERROR":
        buffer.release()
        raise InputError(
            f"the GPU has no memory for {data.nbytes} bytes of a map; build a smaller map with a larger --max-error, "
            "or play with --path fragment or --backend cpu"
        )
    return buffer

"""Maps in buffers, and the compute pass that multiplies with them (row_map.comp and small_map.comp, OpenGL 4.3)."""

from collections.abc import Mapping
from typing import Any

import moderngl
import numpy as np

from counterlight.errors import InputError
from counterlight.gl.gpu_map import GpuMap, Packed
from counterlight.gl.passes import float_texture
from counterlight.gl.shaders import build_compute_program
from counterlight.maps.row_map import RowMap, UintArray
from counterlight.maps.sliced_map import GROUP, lanes_of, parts
from counterlight.maps.sliced_words import lanes_of_words, word_parts
from counterlight.maps.small_map import WORD_BYTES
from counterlight.maps.word_map import WordMap
from counterlight.pipeline.device import LONG_BYTES, Owner

VERSION = 430
PART_ENTRIES = 1 << 23  # entries per buffer; drivers allow more, but the player arranges one part at a time
ROWS, ENTRIES, GROUPS, TARGET = 0, 1, 2, 0  # bindings of the buffers, and of the image


def supports_compute(context: moderngl.Context) -> bool:
    return bool(context.version_code >= VERSION)


class BufferMap(GpuMap[Packed]):
    """A map in buffers.

    shader : multiplies with the map.
    lanes : invocations per row.
    parts : one dispatch each.
    """

    shader: str
    lanes: int
    parts: "list[PartBuffers]"

    def _pass(self, defines: Mapping[str, int | None]) -> "ComputePass":
        return ComputePass(self, {**defines, "GROUP": GROUP, "LANES": self.lanes})

    def _most(self, unit_bytes: int) -> int:
        """Return how many units of this size a buffer may hold."""
        most: int = min(PART_ENTRIES * LONG_BYTES, self.context.info["GL_MAX_SHADER_STORAGE_BLOCK_SIZE"]) // unit_bytes
        return most

    def _part(self, bound: Mapping[int, UintArray]) -> "PartBuffers":
        return self._owner.own(PartBuffers(self.context, bound, len(bound[ROWS]) * self.lanes // GROUP))


class MapBuffers(BufferMap[RowMap]):
    """A row map in buffers."""

    shader = "row_map.comp"

    def _upload(self, packed: RowMap) -> None:
        self.lanes = lanes_of(packed)
        made = parts(packed, self.lanes, self._most(LONG_BYTES))
        self.parts = [self._part({ROWS: part.rows, ENTRIES: part.entries}) for part in made]


class WordBuffers(BufferMap[WordMap]):
    """A map in words, in buffers."""

    shader = "small_map.comp"

    def _upload(self, packed: WordMap) -> None:
        self.lanes = lanes_of_words(packed)
        made = word_parts(packed, self.lanes, self._most(WORD_BYTES))
        self.parts = [self._part({ROWS: part.rows, ENTRIES: part.words, GROUPS: part.groups}) for part in made]


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


class ComputePass:
    """Multiplies with a map in buffers; one dispatch per part."""

    def __init__(self, stored: BufferMap[Any], defines: Mapping[str, int | None]) -> None:
        self._stored = stored
        self._program = build_compute_program(stored.context, stored.shader, defines)
        for name, value in stored.uniforms.items():
            self._program[name] = value
        self.target = float_texture(stored.context, stored.output_shape)

    def run(self, source: moderngl.Texture, base: moderngl.Texture | None = None) -> moderngl.Texture:
        inputs = {"source": source} if base is None else {"source": source, "base": base}
        for unit, (name, texture) in enumerate(inputs.items()):
            self._program[name] = unit
            texture.use(unit)
        self.target.bind_to_image(TARGET, read=False, write=True)
        for part in self._stored.parts:
            part.bind()
            self._program.run(part.groups)
        self._stored.context.memory_barrier()
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
            "or play with --shader fragment or --backend cpu"
        )
    return buffer

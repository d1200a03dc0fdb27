"""Maps on the GPU, and the passes that multiply with them.

A map is a row map (RowMap) or a map in words (WordMap). Fragment shaders read textures (row_map.frag, small_map.frag),
compute shaders read buffers (row_map.comp, small_map.comp, OpenGL 4.3).
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import moderngl
import numpy as np

from counterlight.errors import InputError
from counterlight.gl.passes import ShaderPass, float_texture, integer_texture
from counterlight.gl.shaders import build_compute_program
from counterlight.maps.row_map import RowMap, UintArray
from counterlight.maps.sliced_map import GROUP, lanes_of, lanes_of_words, parts, word_parts
from counterlight.maps.small_map import WORD_BYTES
from counterlight.maps.word_map import WordMap
from counterlight.passes import product
from counterlight.passes.product import Combining
from counterlight.pipeline.device import LONG_BYTES, Owner, Owning, Product

TILE_TEXELS = 1 << 25  # per texture, 512 MiB of entries; llvmpipe ends at 1 GiB, and no driver guarantees more
VERSION = 430
PART_ENTRIES = 1 << 23  # entries per buffer; drivers allow more, but the player arranges one part at a time
ROWS, ENTRIES, GROUPS, TARGET = 0, 1, 2, 0  # bindings of the buffers, and of the image
Packed = TypeVar("Packed", RowMap, WordMap)


class GpuMap(Owning, ABC, Generic[Packed]):
    """A map on the GPU; several passes may share it."""

    def __init__(self, context: moderngl.Context, packed: Packed) -> None:
        self.context, self._owner = context, Owner()
        self.output_shape, self.source_shape = packed.output_shape, packed.source_shape
        self.defines: dict[str, int | None] = {"SOURCE_WIDTH": packed.source_shape[1]}
        self.uniforms: dict[str, float] = {}
        if isinstance(packed, WordMap):
            self.uniforms["scale"] = packed.scale
            self.defines |= {} if packed.colours is None else {"COLOURED": None}
        with self._owner:
            self._upload(packed)

    def product(self, combining: Combining = "") -> Product[moderngl.Texture]:
        """Return target = Σ weights · source, combined with a base as in shaders/product.glsl.

        combining : "" for the product alone, "ADD_TO_BASE", "SUBTRACT_FROM_BASE", "CLAMP", or, for words of T,
            "WEIGHED_RESIDUAL".
        """
        return self._pass(self.defines | ({combining: None} if combining else {}))

    @abstractmethod
    def _upload(self, packed: Packed) -> None: ...

    @abstractmethod
    def _pass(self, defines: Mapping[str, int | None]) -> Product[moderngl.Texture]: ...


@dataclass(frozen=True)
class Tile:
    """Consecutive lines of the entries texture, stored as a separate texture.

    first, lines : first line and number of lines.
    inputs : name -> texture.
    """

    first: int
    lines: int
    inputs: dict[str, moderngl.Texture]


class TextureMap(GpuMap[Packed]):
    """A map in textures.

    shader : multiplies with the map.
    inputs : name -> texture that each tile needs.
    """

    shader: str
    inputs: dict[str, moderngl.Texture]
    tiles: list[Tile]

    def _pass(self, defines: Mapping[str, int | None]) -> "TexturePass":
        return TexturePass(self, defines)


class MapTextures(TextureMap[RowMap]):
    """A row map in textures.

    tile_texels : most texels per texture; a larger map is cut between lines.
    """

    shader = product.SHADER

    def __init__(self, context: moderngl.Context, packed: RowMap, tile_texels: int = TILE_TEXELS) -> None:
        self._tile_texels = tile_texels
        super().__init__(context, packed)

    def _upload(self, packed: RowMap) -> None:
        height, width = packed.entries.shape[:2]
        lines = min(max(1, self._tile_texels // width), self.context.info["GL_MAX_TEXTURE_SIZE"])
        self.inputs = {"lookup": self._owner.own(integer_texture(self.context, packed.lookup))}
        self.tiles = [self._tile(packed, first, min(lines, height - first)) for first in range(0, height, lines)]
        self.defines |= {} if packed.index is None else {"WIDE_INDEX": None}
        self.defines |= {"TILED": None} if len(self.tiles) > 1 else {}

    def _tile(self, packed: RowMap, first: int, lines: int) -> Tile:
        own, entries = self._owner.own, packed.entries[first : first + lines]
        inputs = {"entries": own(float_texture(self.context, entries.shape[:2], entries))}
        if packed.index is not None:
            inputs["wide_index"] = own(integer_texture(self.context, packed.index[first : first + lines]))
        return Tile(first, lines, inputs)


class WordTextures(TextureMap[WordMap]):
    """A map in words, in textures."""

    shader = product.WORDS_SHADER

    def _upload(self, packed: WordMap) -> None:
        arrays = {"rows": packed.rows, "words": packed.words}
        self.inputs = {name: self._owner.own(integer_texture(self.context, each)) for name, each in arrays.items()}
        self.tiles = [Tile(0, len(packed.words), {})]
        self.defines["WORDS_ACROSS"] = packed.words.shape[1]


class TexturePass:
    """Multiplies with a map in textures; one draw per tile."""

    def __init__(self, stored: TextureMap[Any], defines: Mapping[str, int | None]) -> None:
        self._stored, target = stored, float_texture(stored.context, stored.output_shape)
        self._pass = ShaderPass(stored.context, stored.shader, target, defines, **stored.uniforms)

    def run(self, source: moderngl.Texture, base: moderngl.Texture | None = None) -> moderngl.Texture:
        optional = {} if base is None else {"base": base}
        for tile in self._stored.tiles:
            if len(self._stored.tiles) > 1:
                self._pass.set(first_line=tile.first, lines=tile.lines)
            self._pass.run(source=source, **optional, **self._stored.inputs, **tile.inputs)
        return self._pass.target

    def release(self) -> None:
        self._pass.release()


def supports_compute(context: moderngl.Context) -> bool:
    return bool(context.version_code >= VERSION)


class BufferMap(GpuMap[Packed]):
    """A map in buffers.

    shader : multiplies with the map.
    lanes : invocations per row.
    parts : parts of the map, one per dispatch.
    """

    shader: str
    lanes: int
    parts: "list[PartBuffers]"

    def _pass(self, defines: Mapping[str, int | None]) -> "ComputePass":
        return ComputePass(self, {**defines, "GROUP": GROUP, "LANES": self.lanes})

    def _most(self, unit_bytes: int) -> int:
        """Return how many units of this size fit into a buffer."""
        most: int = min(PART_ENTRIES * LONG_BYTES, self.context.info["GL_MAX_SHADER_STORAGE_BLOCK_SIZE"]) // unit_bytes
        return most

    def _part(self, bound: Mapping[int, UintArray]) -> "PartBuffers":
        return self._owner.own(PartBuffers(self.context, bound, len(bound[ROWS]) * self.lanes // GROUP))


class MapBuffers(BufferMap[RowMap]):
    """A row map in buffers."""

    shader = product.COMPUTE_SHADER

    def _upload(self, packed: RowMap) -> None:
        self.lanes = lanes_of(packed)
        made = parts(packed, self.lanes, self._most(LONG_BYTES))
        self.parts = [self._part({ROWS: part.rows, ENTRIES: part.entries}) for part in made]


class WordBuffers(BufferMap[WordMap]):
    """A map in words, in buffers."""

    shader = product.WORDS_COMPUTE_SHADER

    def _upload(self, packed: WordMap) -> None:
        self.lanes = lanes_of_words(packed)
        made = word_parts(packed, self.lanes, self._most(WORD_BYTES))
        self.parts = [self._part({ROWS: part.rows, ENTRIES: part.words, GROUPS: part.groups}) for part in made]


class PartBuffers(Owning):
    """The buffers that one dispatch of `groups` workgroups reads, by binding."""

    def __init__(self, context: moderngl.Context, bound: Mapping[int, UintArray], groups: int) -> None:
        self._owner, self.groups = Owner(), groups
        with self._owner:
            self._buffers = {binding: self._owner.own(_buffer(context, data)) for binding, data in bound.items()}

    def bind(self) -> None:
        for binding, buffer in self._buffers.items():
            buffer.bind_to_storage_buffer(binding)


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

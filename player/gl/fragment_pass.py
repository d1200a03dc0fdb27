"""Maps in textures, and the fragment pass that multiplies with them (shaders/row_map.frag and small_map.frag)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import moderngl

from counterlight.gl.gpu_map import GpuMap, Packed
from counterlight.gl.passes import Pass, float_texture, integer_texture
from counterlight.maps.row_map import RowMap
from counterlight.maps.word_map import WordMap

TILE_TEXELS = 1 << 25  # per texture, 512 MiB of entries; llvmpipe ends at 1 GiB, and no driver guarantees more


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

    shader = "row_map.frag"

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

    shader = "small_map.frag"

    def _upload(self, packed: WordMap) -> None:
        arrays = {"rows": packed.rows, "words": packed.words}
        self.inputs = {name: self._owner.own(integer_texture(self.context, each)) for name, each in arrays.items()}
        self.tiles = [Tile(0, len(packed.words), {})]
        self.defines["WORDS_ACROSS"] = packed.words.shape[1]


class TexturePass:
    """Multiplies with a map in textures; one draw per tile."""

    def __init__(self, stored: TextureMap[Any], defines: Mapping[str, int | None]) -> None:
        self._stored, target = stored, float_texture(stored.context, stored.output_shape)
        self._pass = Pass(stored.context, stored.shader, target, defines, **stored.uniforms)

    def run(self, source: moderngl.Texture, base: moderngl.Texture | None = None) -> moderngl.Texture:
        optional = {} if base is None else {"base": base}
        for tile in self._stored.tiles:
            if len(self._stored.tiles) > 1:
                self._pass.set(first_line=tile.first, lines=tile.lines)
            self._pass.run(source=source, **optional, **self._stored.inputs, **tile.inputs)
        return self._pass.target

    def release(self) -> None:
        self._pass.release()

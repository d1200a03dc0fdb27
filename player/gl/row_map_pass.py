"""Row maps in textures, and the fragment pass that multiplies with them (shaders/row_map.frag)."""

from dataclasses import dataclass

import moderngl

from counterlight.gl.passes import ShaderPass, float_texture, integer_texture
from counterlight.maps.row_map import RowMap
from counterlight.passes.product import SHADER, Combining
from counterlight.pipeline.device import Owner

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


class MapTextures:
    """The textures of one row map; several passes may share them.

    tile_texels : most texels per texture; a larger map is cut between lines.
    """

    def __init__(self, context: moderngl.Context, packed: RowMap, tile_texels: int = TILE_TEXELS) -> None:
        self._context, self._owner = context, Owner()
        self.output_shape, self.source_shape = packed.output_shape, packed.source_shape
        self.is_wide = packed.index is not None
        height, width = packed.entries.shape[:2]
        lines = min(max(1, tile_texels // width), context.info["GL_MAX_TEXTURE_SIZE"])
        try:
            self.lookup = self._owner.own(integer_texture(context, packed.lookup))
            self.tiles = [self._tile(packed, first, min(lines, height - first)) for first in range(0, height, lines)]
        except BaseException:
            self.release()
            raise

    def product(self, combining: Combining = "") -> "RowMapPass":
        return RowMapPass(self._context, self, combining)

    def release(self) -> None:
        self._owner.release()

    def _tile(self, packed: RowMap, first: int, lines: int) -> Tile:
        own, entries = self._owner.own, packed.entries[first : first + lines]
        inputs = {"entries": own(float_texture(self._context, entries.shape[:2], entries))}
        if packed.index is not None:
            inputs["wide_index"] = own(integer_texture(self._context, packed.index[first : first + lines]))
        return Tile(first, lines, inputs)


class RowMapPass:
    """target = Σ weights · source, or base ± this sum, or the sum clamped to 0..1; one draw per tile.

    combining : "" for the product alone, "ADD_TO_BASE", "SUBTRACT_FROM_BASE" or "CLAMP".
    """

    def __init__(self, context: moderngl.Context, textures: MapTextures, combining: Combining = "") -> None:
        defines: dict[str, int | None] = {"SOURCE_WIDTH": textures.source_shape[1]}
        if textures.is_wide:
            defines["WIDE_INDEX"] = None
        if len(textures.tiles) > 1:
            defines["TILED"] = None
        if combining:
            defines[combining] = None
        self._textures = textures
        self._pass = ShaderPass(context, SHADER, float_texture(context, textures.output_shape), defines)

    def run(self, source: moderngl.Texture, base: moderngl.Texture | None = None) -> moderngl.Texture:
        optional = {} if base is None else {"base": base}
        lookup, tiles = self._textures.lookup, self._textures.tiles
        for tile in tiles:
            if len(tiles) > 1:
                self._pass.set(first_line=tile.first, lines=tile.lines)
            self._pass.run(source=source, lookup=lookup, **optional, **tile.inputs)
        return self._pass.target

    def release(self) -> None:
        self._pass.release()

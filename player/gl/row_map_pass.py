"""Row maps in textures, and the fragment pass that multiplies with them (shaders/row_map.frag)."""

import moderngl

from counterlight.gl.passes import Pass, float_texture, integer_texture
from counterlight.maps.row_map import RowMap


class MapTextures:
    """The textures of one row map; several passes may read them."""

    def __init__(self, context: moderngl.Context, packed: RowMap) -> None:
        self._context = context
        self.output_shape, self.source_shape = packed.output_shape, packed.source_shape
        self.inputs = {"lookup": integer_texture(context, packed.lookup)}
        try:
            self.inputs["entries"] = float_texture(context, packed.entries.shape[:2], packed.entries)
            if packed.index is not None:
                self.inputs["wide_index"] = integer_texture(context, packed.index)
        except BaseException:
            self.release()
            raise

    def product(self, combine: str = "") -> "RowMapPass":
        return RowMapPass(self._context, self, combine)

    def release(self) -> None:
        for texture in self.inputs.values():
            texture.release()


class RowMapPass:
    """target = Σ weights · source, or base ± that, or that clamped to 0..1.

    combine : "" for the product alone, "ADD_TO_BASE", "SUBTRACT_FROM_BASE" or "CLAMP".
    """

    def __init__(self, context: moderngl.Context, textures: MapTextures, combine: str = "") -> None:
        defines: dict[str, int | None] = {"SOURCE_WIDTH": textures.source_shape[1]}
        if "wide_index" in textures.inputs:
            defines["WIDE_INDEX"] = None
        if combine:
            defines[combine] = None
        self._textures = textures
        self._pass = Pass(context, "row_map.frag", float_texture(context, textures.output_shape), defines)

    def run(self, source: moderngl.Texture, base: moderngl.Texture | None = None) -> moderngl.Texture:
        optional = {} if base is None else {"base": base}
        return self._pass.run(source=source, **optional, **self._textures.inputs)

    def release(self) -> None:
        self._pass.release()

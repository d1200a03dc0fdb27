"""Maps in words, in textures and in buffers, and the passes that multiply with them (small_map.frag and .comp)."""

import moderngl

from counterlight.gl.compute_pass import ENTRIES, PART_ENTRIES, ROWS, ComputePass, PartBuffers
from counterlight.gl.passes import ShaderPass, float_texture, integer_texture
from counterlight.maps.row_map import UintArray
from counterlight.maps.sliced_map import GROUP
from counterlight.maps.sliced_words import WordPart, lanes_of_words, word_parts
from counterlight.maps.small_map import WORD_BYTES
from counterlight.maps.word_map import WordMap
from counterlight.passes.product import WORDS_COMPUTE_SHADER, WORDS_SHADER, Combining
from counterlight.pipeline.device import Owner

GROUPS = 2  # binding of the workgroups' buffer


class SmallTextures:
    """A map in words, stored in textures; several passes may share them."""

    def __init__(self, context: moderngl.Context, small: WordMap) -> None:
        self._context, self._owner = context, Owner()
        self.small, self.output_shape, self.source_shape = small, small.output_shape, small.source_shape
        try:
            self.inputs = {
                "rows": self._owner.own(integer_texture(context, small.rows)),
                "words": self._owner.own(integer_texture(context, small.words)),
            }
        except BaseException:
            self.release()
            raise

    def product(self, combining: Combining = "") -> "SmallPass":
        return SmallPass(self._context, self, combining)

    def release(self) -> None:
        self._owner.release()


class SmallPass:
    """target = Σ weights · source, or base ± this sum, or w C ∘ (base − sum), or the sum clamped to 0..1.

    combining : "" for the product alone, "ADD_TO_BASE", "SUBTRACT_FROM_BASE", "WEIGHED_RESIDUAL" or "CLAMP".
    """

    def __init__(self, context: moderngl.Context, textures: SmallTextures, combining: Combining = "") -> None:
        small = textures.small
        defines = defines_of(small, combining) | {"WORDS_ACROSS": small.words.shape[1]}
        self._textures, target = textures, float_texture(context, small.output_shape)
        self._pass = ShaderPass(context, WORDS_SHADER, target, defines, scale=small.scale)

    def run(self, source: moderngl.Texture, base: moderngl.Texture | None = None) -> moderngl.Texture:
        optional = {} if base is None else {"base": base}
        return self._pass.run(source=source, **optional, **self._textures.inputs)

    def release(self) -> None:
        self._pass.release()


class SmallBuffers:
    """A map in words, stored in buffers; several passes may share them."""

    def __init__(self, context: moderngl.Context, small: WordMap) -> None:
        self._context, self._owner = context, Owner()
        self.small, self.output_shape, self.source_shape = small, small.output_shape, small.source_shape
        self.lanes = lanes_of_words(small)
        most = min(4 * PART_ENTRIES, context.info["GL_MAX_SHADER_STORAGE_BLOCK_SIZE"] // WORD_BYTES)
        try:
            self.parts = [
                self._owner.own(PartBuffers(context, _bound(part), len(part.rows) * self.lanes // GROUP))
                for part in word_parts(small, self.lanes, most)
            ]
        except BaseException:
            self.release()
            raise

    def product(self, combining: Combining = "") -> ComputePass:
        defines = defines_of(self.small, combining) | {"GROUP": GROUP, "LANES": self.lanes}
        return ComputePass(self._context, self, WORDS_COMPUTE_SHADER, defines, scale=self.small.scale)

    def release(self) -> None:
        self._owner.release()


def _bound(part: WordPart) -> dict[int, UintArray]:
    return {ROWS: part.rows, ENTRIES: part.words, GROUPS: part.groups}


def defines_of(small: WordMap, combining: Combining) -> dict[str, int | None]:
    defines: dict[str, int | None] = {"SOURCE_WIDTH": small.source_shape[1]}
    if small.colours is not None:
        defines["COLOURED"] = None
    return defines | ({combining: None} if combining else {})

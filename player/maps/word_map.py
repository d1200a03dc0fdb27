"""A map in words of 4 bytes as two textures, which may replace the map of 16-byte entries (small_map.py).

rows : a row's first word and, if the map has colours, its colour; one line more than the output, to end the last row.
words : the rows' runs in sequence, line by line.

This module writes and reads the format; shaders/small_map.frag applies it directly, and sliced_map.py rearranges it
for small_map.comp.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from io import BufferedReader
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from counterlight.arrays import brief
from counterlight.errors import InputError
from counterlight.files import exr
from counterlight.files.tables import Table
from counterlight.maps.row_map import MAX_TEXTURE_WIDTH, OpenFile, bands, read_texture, size_of
from counterlight.maps.shelves import MOST_TEXELS
from counterlight.maps.small_map import (
    OTHERS,
    THREE,
    WORD_BYTES,
    IntArray,
    SmallMap,
    Uint32,
    Words,
    parsed,
    unpacked_words,
)

ROWS, WORDS = "rows.exr", "words.exr"
MOST_WORDS = 1 << 27  # 512 MiB of words, the same limit as for a texture of entries


@dataclass(frozen=True)
class WordMap:
    """A map in words.

    rows : (output height + 1, output width, 1 or 2).
    words : (lines, across).
    scale : scale of the codes.
    """

    rows: Uint32
    words: Uint32
    source_shape: tuple[int, int]
    scale: float

    @classmethod
    def of(cls, small: SmallMap) -> "WordMap":
        # imported only when needed, because importing Numba takes half a second
        from counterlight.maps.word_runs import in_words

        made, (height, width) = in_words(small), small.output_shape
        rows = np.full((height + 1, width, 1 if small.colours is None else 2), made.starts[-1], np.uint32)
        rows[..., 0].flat[: made.starts.size] = made.starts
        if small.colours is not None:
            rows[:-1, :, 1], rows[-1, :, 1] = small.colours.reshape(height, width), 0
        across = min(max(made.words.size, 1), MAX_TEXTURE_WIDTH)
        words = np.zeros((max(-(-made.words.size // across), 1), across), np.uint32)
        words.ravel()[: made.words.size] = made.words
        return cls(rows, words, small.source_shape, small.scale)

    __repr__ = brief

    @property
    def output_shape(self) -> tuple[int, int]:
        return self.rows.shape[0] - 1, self.rows.shape[1]

    @property
    def colours(self) -> Uint32 | None:
        return None if self.rows.shape[2] == 1 else self.rows[:-1, :, 1].ravel()

    @property
    def runs(self) -> Words:
        starts = self.rows[..., 0].ravel()[: prod(self.output_shape) + 1].astype(np.int64)
        return Words(self.words.ravel()[: starts[-1]], starts)

    @property
    def nbytes(self) -> int:
        """Bytes that a product reads."""
        return WORD_BYTES * int(self.runs.words.size) + self.rows[:-1].nbytes

    def unpacked(self) -> SmallMap:
        indptr, indices, codes, trust = unpacked_words(self.runs)
        return SmallMap(
            indptr, indices, codes, self.output_shape, self.source_shape, self.colours, trust, scale=self.scale
        )


def write(made: WordMap, folder: Path) -> dict[str, Any]:
    """Write rows.exr and words.exr into `folder`; returns the sizes for the manifest."""
    folder.mkdir(parents=True, exist_ok=True)
    coloured = made.colours is not None
    exr.write_plain(folder / ROWS, {name: made.rows[..., i] for i, name in enumerate(_channels(coloured))})
    exr.write_plain(folder / WORDS, {"WORD": made.words})
    texture = made.words.shape[0], made.words.shape[1]
    return {"texture": size_of(texture), "coloured": coloured, "scale": made.scale}


def read(folder: Path, sizes: Table, shapes: tuple[tuple[int, int], tuple[int, int]], opened: OpenFile) -> WordMap:
    """Read the files of `write`; raises InputError for words that would let a shader read a wrong or missing texel.

    shapes : (height, width) of the output and of the source of the map that it replaces.
    """
    (height, width), source = shapes
    texture = sizes.size("texture", MOST_TEXELS)
    scale = sizes.number("scale", None, 0.0, float(np.finfo(np.float32).max))

    def channels(name: str, names: tuple[str, ...], shape: tuple[int, int]) -> Uint32:
        file: BufferedReader
        with opened(folder / name) as file:
            return read_texture(file, names, shape, np.uint32, lambda rows: None, sizes.fix)

    rows = channels(ROWS, _channels(sizes.truth("coloured", False)), (height + 1, width))
    made = WordMap(rows, channels(WORDS, ("WORD",), texture)[..., 0], source, scale)
    starts = rows[..., 0].ravel().astype(np.int64)
    if starts[0] != 0 or (np.diff(starts) < 0).any() or starts[-1] > prod(texture):
        raise InputError(f"{folder}: a row points outside its words; {sizes.fix}")
    if not _sound(made.runs, prod(source)):
        raise InputError(f"{folder}: a word lies outside the {prod(source)} source pixels; {sizes.fix}")
    return made


def _channels(coloured: bool) -> tuple[str, ...]:
    return ("START", "COLOUR") if coloured else ("START",)


def _sound(made: Words, pixels: int) -> bool:
    """Whether every row ends in a whole entry within the source's pixels; checked in bands."""
    starts = made.starts
    for first, last in bands(starts):
        own: IntArray = starts[first : last + 1] - starts[first]
        kinds, step = parsed(made.words[starts[first] : starts[last]])
        passed = np.concatenate([[0], np.cumsum(step)])
        inside = own[:-1][np.diff(own) > 0]
        if (kinds[inside] == OTHERS).any() or (kinds.size and kinds[-1] == THREE):
            return False
        if (np.diff(passed[own]) >= pixels).any():
            return False
    return True


@dataclass(frozen=True)
class RoomWords:
    """The maps of T and Tᵀ in words, by the name of the row map that each replaces (RoomMaps.named).

    used : largest change of the picture by the words, as a share of the allowed change, at the maps' own white.
    """

    maps: Mapping[str, WordMap]
    used: float

    __repr__ = brief

"""Places the rows of a matrix in the entries texture: sorted by length, so that the texture is full (thesis 5.2)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from counterlight.errors import InputError
from counterlight.files.exr_header import MOST_PIXELS

MOST_TEXELS = MOST_PIXELS  # 16 GiB; OpenGL stores a tall texture in tiles (gl/gpu_maps.py)
SHORTEN = "shorten the rows with --max-cluster, or a larger --max-error or --regularize"
GOOD_FILL = 0.99


def place_rows(
    lengths: NDArray[np.int64], max_width: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], tuple[int, int]]:
    """Place the rows, longest first, in textures of a few widths; return x, y, (height, width) for the smallest one.

    Raises InputError for more than MOST_TEXELS.
    """
    total, longest = int(lengths.sum()), int(lengths.max(initial=0))
    if total == 0:
        zeros = np.zeros(lengths.size, np.int64)
        return zeros, zeros, (1, 1)
    counts = np.bincount(lengths)
    counts[0] = 0
    best: tuple[int, int, list[_Shelf]] | None = None
    for width in _candidate_widths(total, longest, int(counts.argmax()), max_width):
        shelves = _fill_shelves(counts, width)
        height = sum(shelf.repeats for shelf in shelves)
        if best is None or width * height < best[0] * best[1]:
            best = width, height, shelves
        if total >= GOOD_FILL * best[0] * best[1]:
            break
    if best is None or best[0] * best[1] > MOST_TEXELS:
        raise InputError(f"row map: {total} entries, a map holds at most {MOST_TEXELS}; {SHORTEN}")
    width, height, shelves = best
    x, y = _coordinates(lengths, shelves)
    return x, y, (height, width)


def _candidate_widths(total: int, longest: int, commonest: int, max_width: int) -> list[int]:
    """Return texture widths to try, near square first. Multiples of the commonest or longest row waste few texels."""
    square = max(longest, int(np.ceil(np.sqrt(total))))
    widths = []
    for scale in (1.0, 1.5, 2.0, 3.0, 4.0, 8.0, 16.0):
        for unit in (commonest, longest, 1):
            width = -(-int(square * scale) // unit) * unit
            widths.append(min(max(width, longest), max_width))
    return list(dict.fromkeys(widths))


@dataclass(frozen=True)
class _Shelf:
    """Identical texture rows: `repeats` rows, each with `parts` = ((row length, count), …) from x = 0."""

    repeats: int
    parts: tuple[tuple[int, int], ...]


def _fill_shelves(counts: NDArray[np.int64], width: int) -> list[_Shelf]:
    """Fill texture rows greedily with the longest row that still fits; identical texture rows are computed once."""
    left = counts.copy()
    shelves: list[_Shelf] = []
    while True:
        parts: list[tuple[int, int]] = []
        room = width
        for length in np.flatnonzero(left)[::-1]:
            if length <= room:
                many = int(min(left[length], room // length))
                parts.append((int(length), many))
                room -= many * int(length)
        if not parts:
            return shelves
        repeats = min(int(left[length]) // many for length, many in parts)
        for length, many in parts:
            left[length] -= many * repeats
        shelves.append(_Shelf(repeats, tuple(parts)))


def _coordinates(lengths: NDArray[np.int64], shelves: list[_Shelf]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Assign the shelves' places to rows; rows of one length keep their order, so neighbours stay neighbours."""
    order = np.argsort(lengths, kind="stable")
    next_of_length = np.searchsorted(lengths[order], np.arange(int(lengths.max()) + 1))
    x, y = np.zeros(lengths.size, np.int64), np.zeros(lengths.size, np.int64)
    top = 0
    for shelf in shelves:
        left = 0
        for length, many in shelf.parts:
            first = next_of_length[length]
            taken = order[first : first + many * shelf.repeats]
            next_of_length[length] += taken.size
            x[taken] = left + length * np.tile(np.arange(many), shelf.repeats)
            y[taken] = top + np.repeat(np.arange(shelf.repeats), many)
            left += length * many
        top += shelf.repeats
    return x, y

"""Find which file in a folder of Gray-code captures shows which pattern.

Orders:

- `opencv`: the order of cv2.structured_light's GrayCodePattern, with naturally sorted names. First the columns
  (projector x), each bit as pattern and inverse, most significant bit first; then the rows (projector y); white; black.
- `sltk`: the names give the pattern: `…x_bit07_pos`, `…x_bit07_inv`, `…y_bit00_pos` (sltk, and kamino's `gray_KK_…`),
  with optional `white` and `black`.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from counterlight.errors import InputError
from counterlight.files.picture_files import SUFFIXES
from counterlight.writing.numbered import natural

_NAMED = re.compile(r"(?:.*_)?(?P<axis>[xy])_bit(?P<bit>\d{1,2})_(?P<sign>pos|inv)", re.IGNORECASE)


@dataclass(frozen=True)
class Pair:
    """A pattern and its inverse; bit 0 is the finest, with stripes two cells wide."""

    bit: int
    pattern: Path
    inverse: Path


@dataclass(frozen=True)
class Captures:
    """The captures of one room, most significant bit first.

    white, black : floodlit and dark captures; None if they were not taken.
    left_out : number of pictures with an unknown role.
    """

    order: str
    columns: tuple[Pair, ...]
    rows: tuple[Pair, ...]
    white: Path | None
    black: Path | None
    left_out: int


def code_bits(cells: int) -> int:
    """Returns the number of bits for `cells` columns or rows; 1 for a single cell, as in OpenCV."""
    return max(1, (cells - 1).bit_length())


def find_captures(folder: Path, cells: tuple[int, int], order: str | None = None) -> Captures:
    """Find the pattern that each file of `folder` shows.

    cells : (rows, columns) of the code: the projector's size divided by its step.
    order : one of GRAYCODE_ORDERS; None infers it from the names.

    Raises InputError for a missing folder, and for missing, duplicate or superfluous captures.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; name the folder that holds the captures")
    pictures = sorted((p for p in folder.iterdir() if _is_picture(p)), key=lambda p: natural(p.name))
    if not pictures:
        raise InputError(f"{folder}: no captures in it; expected Gray-code pictures ({', '.join(SUFFIXES)})")
    if order is None:
        order = "sltk" if any(_NAMED.fullmatch(p.stem) for p in pictures) else "opencv"
    if order == "sltk":
        return _by_name(folder, pictures, cells)
    return _by_position(folder, pictures, cells)


def _is_picture(path: Path) -> bool:
    return path.suffix.lower() in SUFFIXES and not path.name.startswith(".") and path.is_file()


def _by_position(folder: Path, pictures: Sequence[Path], cells: tuple[int, int]) -> Captures:
    rows, columns = (code_bits(n) for n in cells)
    expected = 2 * (columns + rows) + 2
    if len(pictures) != expected:
        raise InputError(
            f"{folder}: {len(pictures)} captures, expected {expected} for a code of {cells[1]}x{cells[0]} in OpenCV's "
            f"order ({2 * columns} of columns, {2 * rows} of rows, white, black); check --projector, --step and --order"
        )
    split = 2 * columns
    x, y = _paired(pictures[:split]), _paired(pictures[split:-2])
    return Captures("opencv", x, y, pictures[-2], pictures[-1], 0)


def _paired(pictures: Sequence[Path]) -> tuple[Pair, ...]:
    bits = len(pictures) // 2
    return tuple(Pair(bits - 1 - i, pictures[2 * i], pictures[2 * i + 1]) for i in range(bits))


def _by_name(folder: Path, pictures: Sequence[Path], cells: tuple[int, int]) -> Captures:
    named: dict[tuple[str, int, str], Path] = {}
    flood: dict[str, Path] = {}
    for path in pictures:
        if path.stem.lower() in ("white", "black"):
            _add(flood, path.stem.lower(), path)
        elif match := _NAMED.fullmatch(path.stem):
            _add(named, (match["axis"].lower(), int(match["bit"]), match["sign"].lower()), path)
    rows, columns = (_axis_pairs(folder, named, axis, n) for axis, n in zip("yx", cells, strict=True))
    left_out = len(pictures) - len(named) - len(flood)
    return Captures("sltk", columns, rows, flood.get("white"), flood.get("black"), left_out)


def _add(found: dict[Any, Path], key: object, path: Path) -> None:
    if key in found:
        raise InputError(f"{path}: shows the same pattern as {found[key].name}; keep one of the two")
    found[key] = path


def _axis_pairs(folder: Path, named: dict[tuple[str, int, str], Path], axis: str, cells: int) -> tuple[Pair, ...]:
    found = [bit for a, bit, _ in named if a == axis]
    bits = max(code_bits(cells), 1 + max(found, default=0))
    missing = [
        f"{axis}_bit{bit}_{sign}" for bit in range(bits) for sign in ("pos", "inv") if (axis, bit, sign) not in named
    ]
    if missing:
        raise InputError(
            f"{folder}: {len(found)} captures of axis {axis}, expected {2 * bits} for {cells} cells; missing: "
            f"{', '.join(missing[:4])}{' …' if len(missing) > 4 else ''}; check --projector, --step and --order"
        )
    return tuple(Pair(b, named[axis, b, "pos"], named[axis, b, "inv"]) for b in reversed(range(bits)))

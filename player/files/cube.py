"""Three-dimensional colour tables: `.cube` files (Adobe, Cube LUT Specification 1.0).

TITLE "a look"            and other unknown keywords, which are ignored
LUT_3D_SIZE 33            samples along each axis
DOMAIN_MIN 0 0 0          code values of the first samples
DOMAIN_MAX 1 1 1          code values of the last samples
0.01 0.02 0.03            size³ lines of output colours; red changes fastest
"""

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from counterlight.errors import InputError, shown
from counterlight.files.reading import read_bytes

SIZES = 2, 65
MAX_BYTES = 32 << 20  # more than 65³ lines of a hundred characters
FIX = "export it again as a .cube file of 17 to 65 samples along each axis"
_DIGITS = tuple("0123456789+-.")


@dataclass(frozen=True, eq=False)
class Cube:
    """A colour table.

    path : path of its file.
    table : (size, size, size, 3) float32, indexed by blue, green, red.
    low : (3,) float64. Code values of the first samples.
    high : (3,) float64. Code values of the last samples.
    """

    path: Path
    table: NDArray[np.float32]
    low: NDArray[np.float64]
    high: NDArray[np.float64]


def read_cube(path: Path) -> Cube:
    """Read a 3-D table. Raises InputError for another kind of table, a truncated file, or text that is no number."""
    text = read_bytes(path, MAX_BYTES, FIX).decode("utf-8-sig", errors="replace")
    lines = text.splitlines()
    begin = next((number for number, line in enumerate(lines) if line.lstrip()[:1] in _DIGITS), len(lines))
    head = [(number, line.split()) for number, line in enumerate(lines[:begin], 1) if line.strip()]
    size, (low, high) = _size(path, head), _domain(path, head)
    table = _colours(path, lines[begin:], begin)
    if len(table) != size**3:
        raise InputError(f"{path}: {len(table)} colours, LUT_3D_SIZE {size} promises {size**3}; {FIX}")
    return Cube(path, table.reshape(size, size, size, 3), low, high)


def _colours(path: Path, lines: list[str], begin: int) -> NDArray[np.float32]:
    """Parse the table, (lines, 3). Raises InputError for the first line without three numbers.

    begin : number of lines before `lines` in the file.
    """
    if not lines:
        return np.zeros((0, 3), np.float32)
    with suppress(ValueError):
        table = np.loadtxt(lines, np.float32, ndmin=2)
        if table.shape[1] == 3 and np.isfinite(table).all():
            return table
    for number, line in enumerate(lines, begin + 1):
        said = line.partition("#")[0].split()
        if said and _numbers(said) is None:
            raise InputError(f"{path}: line {number}: expected three numbers, found {shown(' '.join(said))}; {FIX}")
    raise InputError(f"{path}: holds no table of numbers; {FIX}")


def _size(path: Path, head: list[tuple[int, list[str]]]) -> int:
    kinds = {words[0]: words[1:] for _, words in head}
    if "LUT_1D_SIZE" in kinds:
        raise InputError(
            f"{path}: holds a table of one dimension; bake it into one of three (ociobakelut --cubesize 33)"
        )
    if "LUT_3D_SIZE" not in kinds:
        raise InputError(f"{path}: no line LUT_3D_SIZE, so no .cube table; {FIX}")
    said = " ".join(kinds["LUT_3D_SIZE"])
    if not said.isdecimal() or not SIZES[0] <= int(said[:4]) <= SIZES[1]:
        raise InputError(f"{path}: LUT_3D_SIZE: expected {SIZES[0]} to {SIZES[1]}, found {shown(said)}; {FIX}")
    return int(said)


def _domain(path: Path, head: list[tuple[int, list[str]]]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return DOMAIN_MIN and DOMAIN_MAX, or DaVinci Resolve's LUT_3D_INPUT_RANGE."""
    low, high = np.zeros(3), np.ones(3)
    for number, (word, *said) in head:
        values = _numbers(said) if word in ("DOMAIN_MIN", "DOMAIN_MAX") else None
        if word == "LUT_3D_INPUT_RANGE" and (ends := _numbers(said, 2)) is not None:
            low, high = np.full(3, ends[0]), np.full(3, ends[1])
        elif values is not None:
            low, high = (values, high) if word == "DOMAIN_MIN" else (low, values)
        elif word in ("DOMAIN_MIN", "DOMAIN_MAX", "LUT_3D_INPUT_RANGE"):
            raise InputError(f"{path}: line {number}: {word}: expected numbers, found {shown(' '.join(said))}; {FIX}")
    if not np.all(low < high):
        raise InputError(f"{path}: its domain ends at {high.tolist()}, where it has not begun ({low.tolist()}); {FIX}")
    return low, high


def _numbers(words: list[str], count: int = 3) -> NDArray[np.float64] | None:
    """Parse `count` numbers within float32. Returns None for anything else."""
    try:
        values = np.array(words, np.float64)
    except ValueError:
        return None
    return values if values.shape == (count,) and np.all(np.abs(values) <= np.finfo(np.float32).max) else None

"""Means of the cells of a picture: the copies of a displayed frame that a watcher gets (docs/watch.md)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from counterlight.passes.drawing import Array, Pass, Picture
from counterlight.passes.kernel import PICTURE, kernel, prange


@dataclass(frozen=True, eq=False)
class Means(Pass[Picture]):
    """The means of the cells of each part, next to each other from the left; black below a part.

    parts : (parts, 3, 3), one `part` each.
    """

    shader = "means.frag"
    source: Picture
    parts: Picture

    def fill(self: "Means[Array]", out: Array) -> None:
        out.fill(0)
        left = 0
        for part in self.parts.astype(np.int64):
            means(self.source, part, left, out)
            left += int(part[0, 2])


def part(
    box: tuple[int, int, int, int], cells: tuple[int, int], extent: tuple[int, int] | None = None
) -> NDArray[np.float32]:
    """Return a row of `Means.parts`, (3, 3).

    box : left, top, width, height in the source.
    cells : (rows, columns).
    extent : (height, width) that the cells divide evenly, at least the box's size; None for the box's size. Cells end
        at the edge of the box.
    """
    left, top, width, height = box
    rows, columns = cells
    down, across = (height, width) if extent is None else extent
    return np.array([(left, top, columns), (width, height, rows), (across, down, 0)], np.float32)


@kernel(f"{PICTURE}, int64[:, ::1], int64, {PICTURE}")
def means(source: Array, part: NDArray[np.int64], start: int, out: Array) -> None:
    """Compute the means of one part, from column `start` of the result on."""
    left, top, columns = part[0, 0], part[0, 1], part[0, 2]
    width, height, rows = part[1, 0], part[1, 1], part[1, 2]
    across, down = part[2, 0], part[2, 1]
    for row in prange(rows):
        upper, lower = min(row * down // rows, height), min((row + 1) * down // rows, height)
        for column in range(columns):
            first, end = min(column * across // columns, width), min((column + 1) * across // columns, width)
            red, green, blue = np.float32(0), np.float32(0), np.float32(0)
            for y in range(top + upper, top + lower):
                for x in range(left + first, left + end):
                    red, green, blue = red + source[y, x, 0], green + source[y, x, 1], blue + source[y, x, 2]
            share = np.float32(1) / np.float32(max((lower - upper) * (end - first), 1))
            out[row, start + column, 0] = share * red
            out[row, start + column, 1] = share * green
            out[row, start + column, 2] = share * blue

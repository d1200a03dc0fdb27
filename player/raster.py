"""The raster: the pictures of several projectors joined into one, for the pipeline and the files (docs/displays.md)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

from counterlight.errors import InputError
from counterlight.files.picture_files import MAX_SIDE

Shape: TypeAlias = tuple[int, int]  # (height, width) in pixels
Shapes: TypeAlias = tuple[Shape, ...]


class Region(NamedTuple):
    """A rectangle of a picture, in pixels."""

    left: int
    top: int
    width: int
    height: int

    @property
    def part(self) -> tuple[slice, slice]:
        """Rows and columns of the rectangle."""
        return slice(self.top, self.top + self.height), slice(self.left, self.left + self.width)


@dataclass(frozen=True)
class Raster:
    """A picture's size in pixels."""

    height: int
    width: int

    def __post_init__(self) -> None:
        if not (1 <= self.height <= MAX_SIDE and 1 <= self.width <= MAX_SIDE):
            raise InputError(f"size {self.width}x{self.height}: expected 1 to {MAX_SIDE} pixels a side")

    @property
    def shape(self) -> Shape:
        return self.height, self.width

    @property
    def pixels(self) -> int:
        return self.height * self.width


def side_by_side(shapes: Sequence[Shape]) -> tuple[Shape, tuple[Region, ...]]:
    """Return the (height, width) of the raster for projectors of these shapes, and each projector's region.

    Projectors stand side by side from the left. A new row begins where a row would exceed the largest width. Each row
    is as high as the highest projector.
    """
    regions, left, top, row = list[Region](), 0, 0, max(height for height, _ in shapes)
    for height, width in shapes:
        if left and left + width > MAX_SIDE:
            left, top = 0, top + row
        regions.append(Region(left, top, width, height))
        left += width
    return (top + row, max(region.left + region.width for region in regions)), tuple(regions)

"""The raster: the pictures of several projectors in one, which the engine and the files know (docs/displays.md)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

from counterlight.errors import InputError
from counterlight.files.picture_files import MAX_SIDE

Shape: TypeAlias = tuple[int, int]  # (height, width)
Shapes: TypeAlias = tuple[Shape, ...]


class Region(NamedTuple):
    """A rectangle of a picture, in pixels."""

    left: int
    top: int
    width: int
    height: int

    @property
    def part(self) -> tuple[slice, slice]:
        """Of a picture: rows and columns."""
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
    """The (height, width) of the raster of projectors of these, and each one's part of it.

    From the left, at the top; where a row would be wider than a picture may be the next begins, each row as high as the
    highest projector of all.
    """
    regions, left, top, row = list[Region](), 0, 0, max(height for height, _ in shapes)
    for height, width in shapes:
        if left and left + width > MAX_SIDE:
            left, top = 0, top + row
        regions.append(Region(left, top, width, height))
        left += width
    return (top + row, max(region.left + region.width for region in regions)), tuple(regions)

"""The screen that several cameras share: the place on it that each camera pixel sees (docs/cameras.md).

The cameras' pictures stand below each other in one raster (thesis eq. 4.7). One large camera in their place would have
the same T, maps and ambient light. The user places a picture on the screen. The target of a camera pixel is the picture
at the place that the pixel sees.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import brief
from counterlight.errors import InputError
from counterlight.files import exr
from counterlight.files.picture_files import MAX_SIDE
from counterlight.files.reading import DescribedFiles
from counterlight.files.tables import Table

FILE, CHANNELS = "screen.exr", ("X", "Y")
MOST_CAMERAS = 64
FARTHEST = 1e6  # largest distance of a position from the screen's upper left, in pixels


@dataclass(frozen=True, eq=False)
class Screen:
    """A screen and the cameras that see it.

    shape : (height, width) of the screen, in pixels.
    cameras : (height, width) of each camera, from the top of the raster.
    positions : (raster height, raster width, 2) float32. x and y on the screen of each pixel's centre, in pixels from
        the upper left, possibly outside the screen. Undefined next to a camera that is narrower than the raster.
    gains : (cameras, 3). Factors of each camera's light, so that all cameras are equally bright where they overlap;
        None for 1.
    """

    shape: tuple[int, int]
    cameras: tuple[tuple[int, int], ...]
    positions: NDArray[np.float32]
    gains: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        for height, width in (self.shape, *self.cameras):
            if not (2 <= height <= MAX_SIDE and 2 <= width <= MAX_SIDE):
                raise InputError(f"screen and cameras: size {width}x{height}, expected 2 to {MAX_SIDE} pixels a side")
        height, width = raster_of(self.cameras)
        if self.positions.shape != (height, width, 2):
            found = "x".join(map(str, self.positions.shape[1::-1]))
            raise InputError(f"screen: positions of {found} pixels, the cameras' raster is {width}x{height}")
        if self.gains is not None and self.gains.shape != (len(self.cameras), 3):
            raise InputError(f"screen: gains of shape {self.gains.shape} for {len(self.cameras)} cameras")
        for number, part in enumerate(self.parts, 1):
            if not np.all(np.abs(self.positions[part]) <= FARTHEST):  # `not`, because a comparison with NaN is false
                raise InputError(f"screen: camera {number} looks where there is no number; join the cameras again")

    __repr__ = brief

    @property
    def parts(self) -> tuple[tuple[slice, slice], ...]:
        """Rows and columns of each camera in the raster."""
        return parts_of(self.cameras)

    @cached_property
    def axes(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """For x and for y, (raster height, raster width, 3): the position, and its slopes along the raster's x and y.

        Both slopes are 0 in pixels without a camera.
        """
        across, down = (np.zeros((*self.positions.shape[:2], 3), np.float32) for _ in range(2))
        for part in self.parts:
            for i, axis in enumerate((across, down)):
                there = self.positions[part][..., i]
                along_y, along_x = np.gradient(there)
                axis[part] = np.stack([there, along_x, along_y], axis=-1)
        return across, down

    def looked_at(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Convert points of the raster to the points of the screen that camera pixels there see: (n, 2), in shares.

        NaN outside the raster and in pixels without a camera.
        """
        across, down = self.axes
        height, width = across.shape[:2]
        found = np.full(points.shape, np.nan)
        inside = np.flatnonzero(((points >= 0) & (points < 1)).all(axis=1))
        x, y = (points[inside] * (width, height)).astype(np.int64).T
        looks = across[y, x, 1:].any(axis=1) | down[y, x, 1:].any(axis=1)
        positions = self.positions[y[looks], x[looks]]
        found[inside[looks]] = positions / self.shape[::-1]
        return found


def raster_of(cameras: tuple[tuple[int, int], ...]) -> tuple[int, int]:
    """Return (height, width) of the raster: the sum of the cameras' heights, and the largest width."""
    return sum(height for height, _ in cameras), max(width for _, width in cameras)


def parts_of(cameras: tuple[tuple[int, int], ...]) -> tuple[tuple[slice, slice], ...]:
    """Return rows and columns of each camera in the raster. All cameras stand at the left."""
    tops = accumulate((height for height, _ in cameras), initial=0)
    return tuple(
        (slice(top, top + height), slice(0, width)) for top, (height, width) in zip(tops, cameras, strict=False)
    )


def write_screen(screen: Screen, folder: Path) -> None:
    exr.write_channels(folder / FILE, {name: screen.positions[..., i] for i, name in enumerate(CHANNELS)})


def read_screen(
    table: Table,
    files: DescribedFiles,
    cameras: tuple[tuple[int, int], ...],
    gains: NDArray[np.float64],
    fix: str,
) -> Screen:
    """Read the screen of a described folder. Raises InputError if it does not fit the cameras.

    table : holds its width and height.
    files : checked access to the folder's files.
    cameras : (height, width) of each camera.
    gains : (cameras, 3).
    fix : advice that ends the messages.
    """
    height, width = (table.integer(key, None, 2, MAX_SIDE) for key in ("height", "width"))
    with files.opened(files.folder / FILE) as file:
        positions = exr.read_stacked(file, CHANNELS, exr.sized(raster_of(cameras), "the cameras' raster", fix))
    try:
        return Screen((height, width), cameras, positions.astype(np.float32, copy=False), gains)
    except InputError as error:
        raise InputError(f"{files.folder / FILE}: {error}") from None

"""Placement of a picture in the view of a camera or projector: fitted with its aspect kept, or pinned by its corners.

If pinned, a pixel centre (x, y) of the target shows the picture at H (x, y, 1). The projective map H takes the four
corners to the picture's corners; player/passes/pinned.py describes the filter.
"""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from counterlight.errors import InputError
from counterlight.files.manifest import write_toml
from counterlight.files.reading import read_toml
from counterlight.files.tables import Table
from counterlight.media.frames import PixelFormat
from counterlight.writing.replacing import remove_file, replacing_file

Corner: TypeAlias = tuple[float, float]
# default corners, clockwise from the picture's upper left, in shares of the view
Corners: TypeAlias = tuple[Corner, Corner, Corner, Corner]
FILE, FORMAT = "placement.toml", 1
FARTHEST = 2.0  # how far outside the view a corner may lie, in widths or heights of the view
SAMPLES = 64  # rows and columns of samples for the share of a picture
SMALLEST_TURN = 1e-4  # smallest cross product of two adjacent sides, in areas of the view


@dataclass(frozen=True)
class Placement:
    """Upper left corner and size, in whole target pixels."""

    left: int
    top: int
    width: int
    height: int


def fit(shape: tuple[int, int], pixel_aspect: float, target: tuple[int, int]) -> Placement:
    """Return the largest placement of a picture (height, width) inside a target (height, width) with its aspect kept.

    pixel_aspect : width of one picture pixel over its height; target pixels are square.
    """
    height, width = shape[0], shape[1] * pixel_aspect
    scale = min(target[0] / height, target[1] / width)
    placed_height = min(max(1, round(height * scale)), target[0])
    placed_width = min(max(1, round(width * scale)), target[1])
    return Placement((target[1] - placed_width) // 2, (target[0] - placed_height) // 2, placed_width, placed_height)


def shown_shape(pixels: PixelFormat) -> tuple[int, int]:
    """Return (height, width) of the upright picture."""
    turned = pixels.rotation % 180 == 90
    return (pixels.width, pixels.height) if turned else (pixels.height, pixels.width)


def place(pixels: PixelFormat, target: tuple[int, int]) -> Placement:
    """Return where the upright picture is fitted in a target (height, width)."""
    aspect = pixels.pixel_aspect
    return fit(shown_shape(pixels), 1 / aspect if pixels.rotation % 180 == 90 else aspect, target)


def corners_of(placement: Placement, target: tuple[int, int]) -> Corners:
    """Return the corners of a placement in a target (height, width); pinning starts from them."""
    left, right = placement.left / target[1], (placement.left + placement.width) / target[1]
    top, bottom = placement.top / target[0], (placement.top + placement.height) / target[0]
    return (left, top), (right, top), (right, bottom), (left, bottom)


def check_corners(corners: Corners) -> None:
    """Raise InputError unless the corners form a convex quadrilateral near the view; it may be mirrored."""
    points = np.asarray(corners, np.float64)
    if points.shape != (4, 2) or not np.all(np.abs(points - 0.5) <= FARTHEST + 0.5):
        raise InputError(
            f"corners {corners}: expected four pairs (x, y), shares of the view, from {-FARTHEST:g} to {FARTHEST + 1:g}"
        )
    sides = np.roll(points, -1, axis=0) - points
    following = np.roll(sides, -1, axis=0)
    turns = sides[:, 0] * following[:, 1] - sides[:, 1] * following[:, 0]
    if abs(np.sign(turns).sum()) != 4 or np.abs(turns).min() < SMALLEST_TURN:
        raise InputError(
            f"corners {corners}: they cross, or three of them lie on a line; "
            "give the upper left, upper right, lower right and lower left corner of the picture"
        )


def homography(corners: Corners, target: tuple[int, int], picture: tuple[int, int]) -> NDArray[np.float64]:
    """Return H, (3, 3), with picture position ~ H (x, y, 1) for a target position, both in pixels from the upper left.

    target, picture : (height, width).

    The third component is positive inside the corners.
    """
    x, y = (np.asarray(corners, np.float64) * (target[1], target[0])).T
    height, width = picture
    u, v = np.array([0, width, width, 0.0]), np.array([0, 0, height, height])
    zero, one = np.zeros(4), np.ones(4)
    equations = np.concatenate(
        [
            np.stack([x, y, one, zero, zero, zero, -u * x, -u * y], axis=1),
            np.stack([zero, zero, zero, x, y, one, -v * x, -v * y], axis=1),
        ]
    )
    H = np.append(np.linalg.solve(equations, np.concatenate([u, v])), 1.0).reshape(3, 3)
    middle = H[2] @ (x.mean(), y.mean(), 1.0)
    return np.asarray(H / middle)


def share_outside(corners: Corners, lit: NDArray[np.bool_]) -> float:
    """Return the share of a picture at these corners that lies outside the lit pixels of a view.

    lit : (view height, view width) bool.
    """
    at = (np.arange(SAMPLES) + 0.5) / SAMPLES
    picture = np.stack([*map(np.ravel, np.meshgrid(at, at)), np.ones(SAMPLES**2)])
    x, y, w = np.linalg.solve(homography(corners, lit.shape, (1, 1)), picture)
    columns, rows = (np.floor(each / w).astype(np.intp) for each in (x, y))
    inside = (rows >= 0) & (rows < lit.shape[0]) & (columns >= 0) & (columns < lit.shape[1])
    return float(1 - np.count_nonzero(lit[rows[inside], columns[inside]]) / SAMPLES**2)


def read_placement(folder: Path) -> Corners | None:
    """Read the corners stored with a calibration; None if there are none."""
    path, fix = folder / FILE, "place the picture again, or remove the file"
    if not os.path.exists(path):
        return None
    table = Table(read_toml(path, fix), f"{path}", fix)
    table.format(FORMAT)
    a, b, c, d = ((x, y) for x, y in table.rows("corners", 4, 2, -FARTHEST, FARTHEST + 1).tolist())
    try:
        check_corners((a, b, c, d))
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    return a, b, c, d


def write_placement(folder: Path, corners: Corners | None) -> Path:
    """Write the corners next to a calibration, or remove the file for None. Returns the file's path."""
    path = folder / FILE
    if corners is None:
        remove_file(path)
        return path
    check_corners(corners)
    with replacing_file(path) as temporary:
        write_toml(temporary, {"format": FORMAT, "corners": [list(corner) for corner in corners]})
    return path

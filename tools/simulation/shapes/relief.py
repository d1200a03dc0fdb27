"""Reliefs: heights over a parallelogram, towards the camera's side."""

from pathlib import Path

import cv2
import numpy as np

from counterlight.arrays import FloatArray
from counterlight.errors import InputError
from counterlight.files.picture_files import grey, read_picture
from counterlight.tools.simulation.shapes.parallelogram import Parallelogram
from counterlight.tools.simulation.shapes.triangles import Triangles, over_grid

MAX_HEIGHTS = 1 << 26


def relief(base: Parallelogram, heights: FloatArray, *, cut: bool) -> Triangles:
    """Returns a surface with heights over a parallelogram.

    heights : (rows, columns), metres above the base, row 0 at v = 0.
    cut : omit the parts that do not rise above 0.
    """
    rows, columns = heights.shape
    u, v = np.meshgrid(np.linspace(0, 1, columns), np.linspace(0, 1, rows))
    points = base.at(u, v) + heights[..., None] * base.normal
    keep = None
    if cut:
        keep = (heights[:-1, :-1] > 0) | (heights[:-1, 1:] > 0) | (heights[1:, :-1] > 0) | (heights[1:, 1:] > 0)
    if np.cross(base.edge_u, base.edge_v) @ base.normal < 0:  # the grid's normals must agree with the base's normal
        points = points[:, ::-1]
        keep = None if keep is None else keep[:, ::-1]
    return over_grid(points, keep, closed=False, wraps=False)


def read_heights(path: Path, where: str, columns: int, rows: int) -> FloatArray:
    """Read a grey picture as heights (rows, columns).

    The picture has 8 or 16 bits, white is 1, black is 0, and its bottom row is at v = 0.
    """
    try:
        picture = grey(read_picture(path, MAX_HEIGHTS, upright=True))
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    heights = picture.astype(np.float64) / np.iinfo(picture.dtype).max
    return np.asarray(cv2.resize(heights, (columns, rows), interpolation=cv2.INTER_AREA)[::-1], np.float64)

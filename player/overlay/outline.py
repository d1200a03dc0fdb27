"""The outline of a picture that is being placed: points of the shown picture along the outline, and its handles.

In the camera's views, the outline is the quadrilateral of the corners. In the projector's picture, each point is drawn
at the pixel that lights it most, so that the outline appears at the same place in the scene. The outline has gaps where
the projector does not reach.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from counterlight.maps.row_map import RowMap
from counterlight.pipeline.placement import Corners
from counterlight.screen import Screen

Points: TypeAlias = NDArray[np.float64]  # (n, 2), x and y in shares of a picture, from its upper left
# half widths, and the width of the edge around them, in pixels of a window of REFERENCE_HEIGHT
LINE, HANDLE, EDGE = 1, 6, 2
INK, GROUND, SELECTED = (255, 255, 255, 255), (0, 0, 0, 255), (255, 200, 0, 255)
MOST_POINTS = 1000  # most points per side of the outline
NEARBY = 2  # largest distance, in pixels of the screen, at which a camera pixel sees a corner


@dataclass(frozen=True, eq=False)
class Outline:
    """The points of an outline.

    points : points along the sides.
    handles : the selected corner, or all four corners.
    """

    points: Points
    handles: Points


def outline_of(corners: Corners, corner: int | None, camera: tuple[int, int]) -> Outline:
    """Return an outline in shares of the camera's view, with about one point per pixel.

    corners : corners of the picture.
    corner : the selected corner; None for all.
    camera : (height, width).
    """
    ends = np.asarray(corners, np.float64)
    sides = []
    for start, end in zip(ends, np.roll(ends, -1, axis=0), strict=True):
        steps = int(np.clip(np.abs((end - start) * camera[::-1]).max(), 1, MOST_POINTS))
        sides.append(start + np.linspace(0, 1, steps, endpoint=False)[:, None] * (end - start))
    return Outline(np.concatenate(sides), ends if corner is None else ends[corner : corner + 1])


def outline_on(screen: Screen, corners: Corners, corner: int | None) -> Outline:
    """Return an outline in shares of several cameras' raster: pixels that see the edge, and handles in each camera."""
    at = screen.positions / np.array(screen.shape[::-1], np.float64)
    inside = _inside(corners, at)
    points, handles = [], []
    for rows, columns in screen.parts:
        part = np.pad(inside[rows, columns], 1, mode="edge")
        alike = (part[1:-1, :-2] == part[1:-1, 1:-1]) & (part[:-2, 1:-1] == part[1:-1, 1:-1])
        points.append(np.argwhere(~alike) + np.array([rows.start, columns.start]))
        for end in corners if corner is None else corners[corner : corner + 1]:
            away = np.abs(at[rows, columns] - end) * screen.shape[::-1]
            nearest = np.unravel_index(np.argmin(away.max(axis=2)), away.shape[:2])
            if away[nearest].max() <= NEARBY:
                handles.append((nearest[0] + rows.start, nearest[1] + columns.start))
    pixels = np.concatenate(points), np.reshape(handles, (-1, 2))
    return Outline(*((each[:, ::-1] + 0.5) / at.shape[1::-1] for each in pixels))


def _inside(corners: Corners, at: Points) -> NDArray[np.bool_]:
    """Return which of the points, (…, 2), are inside a convex quadrilateral."""
    ends = np.asarray(corners, np.float64)
    sides = np.roll(ends, -1, axis=0) - ends
    away = at[..., None, :] - ends
    turns = sides[:, 0] * away[..., 1] - sides[:, 1] * away[..., 0]
    return np.asarray((turns >= 0).all(axis=-1) | (turns <= 0).all(axis=-1))


def moved(outline: Outline, where: Callable[[Points], Points]) -> Outline:
    return Outline(where(outline.points), where(outline.handles))


def lit_by(transport: RowMap, points: Points) -> Points:
    """Return the centre of the projector pixel that lights each point of the camera's view most; NaN if there is none.

    transport : T, from projector pixels to camera pixels.
    points : (n, 2), in shares of the camera's view.
    """
    height, width = transport.output_shape
    source_width = transport.source_shape[1]
    found = np.full(points.shape, np.nan)
    pixels = np.minimum(points * (width, height), (width - 1, height - 1)).astype(np.int64)
    for number in np.flatnonzero(((points >= 0) & (points <= 1)).all(axis=1)):
        x, y, length = (int(value) for value in transport.lookup[pixels[number, 1], pixels[number, 0]])
        if length:
            best = x + int(transport.entries[y, x : x + length, :3].sum(axis=1).argmax())
            index = int(transport.entries[y, best, 3] if transport.index is None else transport.index[y, best])
            found[number] = index % source_width + 0.5, index // source_width + 0.5
    return np.asarray(found / transport.source_shape[::-1])


def draw_outline(canvas: NDArray[np.uint8], outline: Outline, place: Callable[[Points], Points], scale: float) -> None:
    """Draw on a window's overlay, (height, width, RGBA): a white line with dark edges, and handles in another colour.

    outline : in shares of the shown picture.
    place : converts shares of the shown picture to pixels of the window.
    scale : factor of the line's width.
    """
    line, handles = (place(points[np.isfinite(points).all(axis=1)]) for points in (outline.points, outline.handles))
    for points, half, colour in (
        (line, LINE + EDGE, GROUND),
        (line, LINE, INK),
        (handles, HANDLE + EDGE, GROUND),
        (handles, HANDLE, SELECTED),
    ):
        _stamp(canvas, points, round(half * scale), colour)


def _stamp(canvas: NDArray[np.uint8], points: Points, half: int, colour: tuple[int, ...]) -> None:
    """Draw squares around points, 2 · half + 1 pixels wide and high, clipped to the canvas."""
    middles = np.floor(points).astype(np.int64)
    offsets = np.mgrid[-half : half + 1, -half : half + 1].reshape(2, -1)[::-1].T
    x, y = (middles[:, None] + offsets).reshape(-1, 2).T
    inside: Any = (x >= 0) & (x < canvas.shape[1]) & (y >= 0) & (y < canvas.shape[0])
    canvas[y[inside], x[inside]] = colour

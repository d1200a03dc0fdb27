"""Paints of surfaces: shares of pigments, in texels of a quarter of a camera pixel, drawn with OpenCV.

Every painter returns (rows, columns, pigments), shares that sum to 1. The fine grain differs from texel to texel, so
that no camera pixel has a single reflectance.
"""

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from tests.rig.light import BLUE, GREY, INK, PAPER, PIGMENTS, RED, YELLOW
from tests.rig.rays import FloatArray

Paint = NDArray[np.float32]
Painter = Callable[[tuple[int, int], np.random.Generator], Paint]

GRAIN = 0.25  # largest grey share of a texel's paper
PENCIL = 0.15
BLOTS = (
    (0.45, 0.35, 0.045),
    (0.6, 0.62, 0.03),
    (0.72, 0.4, 0.022),
    (0.38, 0.7, 0.022),
)  # middle and radius, as shares of the sides


def wallpaper(size: tuple[int, int], rng: np.random.Generator) -> Paint:
    """Coloured stripes on paper that darkens to the right, grain, pencil lines, and blots of dark ink."""
    paint = _paper(size, rng)
    x = np.linspace(0, 1, size[1])
    for pigment, phase in ((BLUE, 0.0), (YELLOW, 2.1), (RED, 4.2)):
        _cover(paint, pigment, 0.7 * np.clip(np.sin(2 * np.pi * 5 * x + phase) - 0.2, 0, 1))
    _cover(paint, GREY, 0.35 * x)
    _draw_lines(paint, 24)
    _spill(paint)
    return paint


def plaster(size: tuple[int, int], rng: np.random.Generator) -> Paint:
    """Paper with grain and large soft clouds of two colours."""
    paint = _paper(size, rng)
    for pigment in (YELLOW, BLUE):
        _cover(paint, pigment, 0.5 * _clouds(size, 6, rng))
    return paint


def painted_red(size: tuple[int, int], rng: np.random.Generator) -> Paint:
    """Paper with grain, half covered by red paint, lighter towards the top."""
    paint = _paper(size, rng)
    _cover(paint, RED, np.linspace(0.35, 0.65, size[0])[:, None] * np.ones(size[1]))
    return paint


def painted_grey(size: tuple[int, int], rng: np.random.Generator) -> Paint:
    """Plaster, a third of it covered by grey paint."""
    paint = plaster(size, rng)
    _cover(paint, GREY, np.full(size, 0.35))
    return paint


def lined(size: tuple[int, int], rng: np.random.Generator) -> Paint:
    """Paper with grain, blue clouds and pencil lines."""
    paint = _paper(size, rng)
    _cover(paint, BLUE, 0.4 * _clouds(size, 5, rng))
    _draw_lines(paint, 16)
    return paint


def _paper(size: tuple[int, int], rng: np.random.Generator) -> Paint:
    paint = np.zeros((*size, len(PIGMENTS)), np.float32)
    paint[..., PAPER] = 1
    _cover(paint, GREY, GRAIN * rng.random(size))
    return paint


def _cover(paint: Paint, pigment: int, share: FloatArray) -> None:
    """Paint over the existing paint.

    share : 0..1, broadcast to (rows, columns).
    """
    covered = np.broadcast_to(share, paint.shape[:2])[..., None].astype(np.float32)
    paint *= 1 - covered
    paint[..., pigment] += covered[..., 0]


def _clouds(size: tuple[int, int], cells: int, rng: np.random.Generator) -> FloatArray:
    coarse = rng.random((cells, cells)).astype(np.float32)
    fine = cv2.resize(coarse, size[::-1], interpolation=cv2.INTER_CUBIC)
    return np.clip(fine, 0, 1).astype(np.float64)


def _draw_lines(paint: Paint, count: int) -> None:
    """Draw slanting lines, one texel wide."""
    height, width = paint.shape[:2]
    page = np.zeros((height, width), np.uint8)
    for row in np.linspace(0, height, count, endpoint=False).astype(int):
        cv2.line(page, (0, int(row)), (width, int(row) + height // 9), 255, 1, cv2.LINE_AA)
    _cover(paint, INK, PENCIL * page / 255.0)


def _spill(paint: Paint) -> None:
    """Draw blots of ink: black cores of some camera pixels that fade over a few more."""
    height, width = paint.shape[:2]
    y, x = np.indices((height, width)) * (1 / height)
    for left, top, radius in BLOTS:
        distance = np.hypot(x - left * width / height, y - top)
        _cover(paint, INK, 1 / (1 + np.exp((distance - radius) / (0.18 * radius))))


def sampled(paint: Paint, shares: FloatArray) -> Paint:
    """Returns the paint (n, pigments) at (n, 2) shares of the surface's sides, by bilinear interpolation."""
    height, width = paint.shape[:2]
    x = np.clip(shares[:, 0] * width - 0.5, 0, width - 1)
    y = np.clip(shares[:, 1] * height - 0.5, 0, height - 1)
    left = np.minimum(x.astype(np.int64), max(width - 2, 0))
    top = np.minimum(y.astype(np.int64), max(height - 2, 0))
    right, below = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    fx, fy = (x - left)[:, None].astype(np.float32), (y - top)[:, None].astype(np.float32)
    upper = paint[top, left] * (1 - fx) + paint[top, right] * fx
    lower = paint[below, left] * (1 - fx) + paint[below, right] * fx
    return np.asarray(upper * (1 - fy) + lower * fy)

"""The CPU twins of the shaders behind player/picture.py, in numpy, as player/reference.py has those of the pipeline.

tone : (s, o), see player/content.py.  reach : (camera height, camera width, 4), the radiance of full drive, and 1 where
a pixel is inside the mask and lit in every channel, 0 elsewhere.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from counterlight.content import OFFSETS, SCALES, tile_grid
from counterlight.views import (
    CLIP_FAINT,
    CLIP_SPAN,
    ERROR_SPAN,
    IMPOSSIBLE,
    MID_GREY,
    OVER,
    SLACK,
    UNCOUNTED,
    UNDER,
    error_colours,
)

FloatArray = NDArray[np.floating]
MOST_TAPS = 32  # along an axis; a filter that is wider takes every second sample, or every third …


def pinned(picture: FloatArray, target: tuple[int, int], H: FloatArray) -> FloatArray:
    """Place a picture by a projective map, black around it (pinned.frag).

    H : target position -> picture position, in pixels (counterlight.placement.homography).
    A tent along each axis of the picture, as wide as a target pixel is there: its half width is √(∂x² + ∂y²) of the
    map's derivatives and at least one pixel, so that an upright placement is filtered as by resample. Edges are covered
    by the part of a pixel that lies inside, from its distance to the edge.
    """
    y, x = np.mgrid[: target[0], : target[1]] + 0.5
    u, v, w = np.einsum("ij,jyx->iyx", H, np.stack([x, y, np.ones_like(x)]))
    ahead = w > 0
    w = np.where(ahead, w, 1)
    u, v = u / w, v / w
    reach_u = np.hypot(H[0, 0] - u * H[2, 0], H[0, 1] - u * H[2, 1]) / w
    reach_v = np.hypot(H[1, 0] - v * H[2, 0], H[1, 1] - v * H[2, 1]) / w
    height, width = picture.shape[:2]
    inside = np.minimum(np.minimum(u, width - u) / reach_u, np.minimum(v, height - v) / reach_v)
    cover = np.where(ahead, np.clip(inside + 0.5, 0, 1), 0)
    shown = cover > 0
    sums, total = np.zeros((np.count_nonzero(shown), 3)), np.zeros((np.count_nonzero(shown), 1))
    across = list(_taps(u[shown], np.maximum(reach_u[shown], 1), width))
    for row, down in _taps(v[shown], np.maximum(reach_v[shown], 1), height):
        for column, weight in across:
            weight = (down * weight)[:, None]
            sums += weight * picture[row, column]
            total += weight
    result = np.zeros((*target, 3))
    result[shown] = cover[shown][:, None] * np.divide(sums, total, out=np.zeros_like(sums), where=total > 0)
    return result


def _taps(centre: FloatArray, radius: FloatArray, count: int) -> Iterator[tuple[NDArray[np.int64], FloatArray]]:
    """The first tap of every filter along an axis and its weight, then the second, …; weight 0 where there is none."""
    step = np.maximum(np.ceil(2 * radius / MOST_TAPS), 1)
    tap = np.maximum(np.ceil(centre - radius - 0.5), 0)
    last = np.minimum(np.floor(centre + radius - 0.5), count - 1)
    while np.any(tap <= last):
        weight = np.where(tap <= last, np.maximum(0, 1 - np.abs(tap + 0.5 - centre) / radius), 0)
        yield np.minimum(tap, count - 1).astype(int), weight
        tap = tap + step


def toned(picture: FloatArray, unit: float, black_level: float, tone: FloatArray) -> FloatArray:
    """s u + o in shares of white, u = black level + (1 − black level) unit picture (desired.frag with TONE)."""
    return np.asarray(tone[0] * (black_level + (1 - black_level) * (unit * picture)) + tone[1])


def reach_of(seen: FloatArray, ambient: FloatArray, mask: NDArray[np.bool_]) -> FloatArray:
    """What full drive gives, `seen`, and which pixels count (reach.frag)."""
    lit = mask & np.all(seen > ambient, axis=2)
    return np.concatenate([seen, lit[..., None]], axis=2)


@dataclass(frozen=True)
class Limits:
    """What a room lets a camera pixel have, (camera height, camera width, 3) each; see player/content.py.

    near_white : 1 − F 1.  near_ambient : e − F e.  ambient : e.  most : S·1, and a fourth channel, 0 where a pixel does
    not count.
    """

    near_white: FloatArray
    near_ambient: FloatArray
    ambient: FloatArray
    most: FloatArray


def clip_sums(
    u: FloatArray, near: FloatArray, limits: Limits, white: float, budget: float, offset: float | None
) -> FloatArray:
    """What clips less what may, of 16 candidates, over all samples (clip_sums.frag, then block_sum.frag).

    u : in shares of white.  near : u − F u.  budget : share of A.  offset : o, of which the scales are tried; None
    tries the offsets at s = 1 − o, and counts only what is too dark. Returns (16,).
    """
    tile, step = tile_grid(u.shape[:2])
    at = np.ix_(*(_samples(u.shape[axis], tile[axis], step[axis]) for axis in (0, 1)))
    ambient, most = limits.ambient[at], limits.most[at]
    offsets, shares = (OFFSETS, np.ones(16)) if offset is None else (np.full(16, offset), SCALES)
    allowed = budget * np.maximum(white * u[at], ambient)
    sums = np.empty(16)
    for i, (o, share) in enumerate(zip(offsets, shares, strict=True)):
        needed = white * ((1 - o) * share * near[at] + o * limits.near_white[at]) - limits.near_ambient[at]
        clipped = np.maximum(-needed, 0)
        if offset is not None:
            clipped = clipped + np.maximum(needed - most[..., :3], 0)
        sums[i] = np.sum((clipped - allowed) * most[..., 3:])
    return sums


def _samples(length: int, tile: int, step: int) -> NDArray[np.int64]:
    starts = range(0, length, tile)
    return np.concatenate([np.arange(start, min(start + tile, length), step) for start in starts])


def choose(candidates: FloatArray, sums: FloatArray, otherwise: int) -> float:
    """The first candidate whose sum is at most 0, moved towards the one before as far as a line allows (choose.frag).

    otherwise : the candidate to take where there is none.
    """
    within = np.flatnonzero(sums <= 0)
    if not within.size:
        return float(candidates[otherwise])
    i = within[0]
    if i == 0:
        return float(candidates[0])
    share = sums[i - 1] / (sums[i - 1] - sums[i])
    return float(candidates[i - 1] + share * (candidates[i] - candidates[i - 1]))


def tone_of(u: FloatArray, near: FloatArray, limits: Limits, white: float, budget: float) -> NDArray[np.float64]:
    """(s, o) for one picture."""
    sums = clip_sums(u, near, limits, white, budget / 2, None)
    offset = choose(OFFSETS, sums, len(OFFSETS) - 1)
    sums = clip_sums(u, near, limits, white, budget, offset)
    return np.array([(1 - offset) * choose(SCALES, sums, int(np.argmin(sums))), offset])


def blend(now: FloatArray, before: FloatArray, weight: float) -> FloatArray:
    """(1 − weight) now + weight before (blend.frag)."""
    return np.asarray((1 - weight) * now + weight * before)


def error_map(
    seen: FloatArray, ambient: FloatArray, b: FloatArray, reach: FloatArray, white: float
) -> NDArray[np.float64]:
    """What the camera sees less what was asked, of the channel that is furthest off, as colours (error_map.frag)."""
    error = (seen - ambient - b) / white
    rows, columns = np.indices(error.shape[:2])
    worst = error[rows, columns, np.argmax(np.abs(error), axis=2)]
    colours = error_colours()
    position = (np.clip(worst / ERROR_SPAN, -1, 1) + 1) / 2
    grid = np.linspace(0, 1, len(colours))
    light = np.stack([np.interp(position, grid, colours[:, i]) for i in range(3)], axis=-1)
    return np.asarray(white * np.where(reach[..., 3:] > 0, light, UNCOUNTED))


def impossible(reach: FloatArray, white: float) -> NDArray[np.float64]:
    """The colour of what a camera pixel cannot be asked for (impossible.frag); classes as in player/views.py."""
    short = np.stack(shortfalls(reach, white))
    return np.asarray(white * IMPOSSIBLE[np.where(short.any(axis=0), 1 + short.argmax(axis=0), 0)])


def shortfalls(reach: FloatArray, white: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """Camera pixels that do not count, cannot reach mid grey, cannot reach white: (camera height, camera width)."""
    least, lit = reach[..., :3].min(axis=2) * (1 + SLACK), reach[..., 3] > 0
    return ~lit, lit & (least < MID_GREY * white), lit & (least < white)


def clipping(view: FloatArray, asked: FloatArray, most: FloatArray | float, white: float) -> NDArray[np.float64]:
    """Colour what is asked for below 0 or above `most`, by how far, of the worst channel (clipping.frag).

    white : light of the colours, and what amounts are shares of.
    """
    over = np.max(asked - most, axis=2, keepdims=True) / white
    under = np.max(-asked, axis=2, keepdims=True) / white
    amount = np.maximum(np.maximum(over, under), 0)
    weight = 0.5 * np.minimum(amount / CLIP_FAINT, 1) + 0.5 * np.minimum(amount / CLIP_SPAN, 1)
    colour = white * np.where(over >= under, OVER, UNDER)
    return np.asarray(view + weight * (colour - view))

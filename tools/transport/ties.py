"""Transfers knowledge about pixels on one side of T to pixels on the other side, through the light that they share.

Two cameras that see one projector pixel see one place of the room. Knowledge about one camera's pixels (place,
brightness) is carried through its T to the projector pixels, and from there through the other camera's T.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import BoolArray, FloatArray, IntArray
from counterlight.tools.transport.transport import Csr

REACH = 3.0  # times a footprint's usual radius; light further from its centre took another way through the room
BRIGHT_PERCENTILE, FAINTEST = 95.0, 0.02  # below this share of the 95th percentile, light is too faint to locate
WHOLE = 0.98  # share of a footprint that must be known, so that its centre is right


@dataclass(frozen=True)
class Carried:
    """Values carried through T.

    values : (receivers, n). Undefined where not `known`.
    known : (receivers,) bool.
    """

    values: FloatArray
    known: BoolArray


def carried(T: Csr, width: int, values: FloatArray, known: BoolArray) -> Carried:
    """Return the mean over each receiver's main footprint, weighted by light.

    The main footprint lies around its centre, found from its brightest entry; glass and mirrors add others.

    T : (receivers, givers). Luminance.
    width : width of the givers' picture.
    values : (givers, n).
    known : (givers,).
    """
    count = T.shape[0]
    rows = np.repeat(np.arange(count), np.diff(T.indptr))
    light, place = T.data.astype(np.float64), np.stack(np.divmod(T.indices.astype(np.int64), width), axis=1)
    inside = _main_footprint(rows, place, light, count)
    rows, given, light = rows[inside], T.indices[inside], light[inside]
    total = np.bincount(rows, light, count)
    told = np.where(known[given], light, 0)
    heard = np.bincount(rows, told, count)
    sums = np.stack([np.bincount(rows, told * np.where(known, each, 0)[given], count) for each in values.T], axis=1)
    lit = total > FAINTEST * np.percentile(total[total > 0], BRIGHT_PERCENTILE) if total.any() else total > 0
    means = np.divide(sums, heard[:, None], out=np.zeros_like(sums), where=heard[:, None] > 0)
    return Carried(means, lit & (heard >= WHOLE * total))


def _main_footprint(rows: IntArray, place: IntArray, light: FloatArray, count: int) -> BoolArray:
    """Return the entries around the centre of their row's brightest spot, (entries,) bool."""
    most = np.zeros(count)
    np.maximum.at(most, rows, light)
    brightest = np.flatnonzero((light == most[rows]) & (light > 0))
    found, first = np.unique(rows[brightest], return_index=True)
    middle = np.zeros((count, 2))
    middle[found] = place[brightest[first]]
    away = _squared(place - middle[rows])
    usual = np.sqrt(np.bincount(rows, light * away, count)[found] / np.bincount(rows, light, count)[found])
    reach = 1 + REACH * float(np.median(usual)) if found.size else 1.0
    near = np.where(away <= reach**2, light, 0)
    total = np.bincount(rows, near, count)
    for axis in range(2):
        middle[:, axis] = np.divide(
            np.bincount(rows, near * place[:, axis], count), total, where=total > 0, out=middle[:, axis]
        )
    return np.asarray(_squared(place - middle[rows]) <= reach**2)


def _squared(offsets: NDArray[np.floating]) -> FloatArray:
    return np.asarray((offsets**2).sum(axis=1))

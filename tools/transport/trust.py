"""How far a camera pixel is to be trusted, and which projector pixels any trusted one sees: from T alone.

Where the projector's raster ends, it cuts footprints. A pixel whose footprint is cut cannot reach its target, and what
is tried in vain spoils its neighbours. That it is cut shows in T's row, without any knowledge of the scene: the line of
projector pixels at the raster's edge then has more of the row's light than a line of a whole footprint ever has.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse

from counterlight.arrays import FloatArray
from counterlight.maps.row_map import SparseRows
from counterlight.tools.transport.transport import luminance

LEAST_TRUST = 0.01
CUT, WIDE_AND_CUT, FALL = 1.1, 1.3, 0.5  # of what a whole footprint can have in one line
UNTOUCHED = 0.05  # share of a row's light at the edge, below which its footprint is whole for certain
NEARBY = 9  # camera pixels a side, over which whole footprints are averaged
FEW = 0.1  # of those pixels


@dataclass(frozen=True)
class _Shares:
    """T by rows, each entry as a share of its row's light; y, x : the entry's projector pixel."""

    rows: NDArray[np.int64]
    y: NDArray[np.int64]
    x: NDArray[np.int64]
    share: FloatArray
    camera: tuple[int, int]

    @classmethod
    def of(cls, near: SparseRows, camera: tuple[int, int], projector: tuple[int, int]) -> "_Shares":
        light, rows = luminance(near.weights), near.rows
        total = np.bincount(rows, light, near.shape[0])[rows]
        y, x = np.divmod(near.indices.astype(np.int64), projector[1])
        return cls(rows, y, x, np.divide(light, total, out=np.zeros_like(light), where=total > 0), camera)


def trust(near: SparseRows, counts: NDArray[np.bool_], projector: tuple[int, int]) -> FloatArray:
    """w, (camera pixels,): 1 inside the mask, little where else near light falls, 0 where none does.

    Those of little trust are satisfied where no trusted pixel objects: the rim of the picture, what the camera could
    not measure, what somebody's mask leaves out. Where an edge cuts a footprint, w falls from 0.4 to LEAST_TRUST over
    `cut_by_edges` of 1.1 to 1.3: narrow footprints, of which nearly all is one line, disturb no others.

    near : T, (camera pixels, projector pixels).  counts : (camera height, camera width), the mask.
    """
    lit = np.bincount(near.rows, luminance(near.weights), near.shape[0]) > 0
    cut = cut_by_edges(near, (counts.shape[0], counts.shape[1]), projector)
    narrow = (cut >= CUT) * np.clip((WIDE_AND_CUT - cut) / FALL, 0, 1)
    return np.where(counts.ravel(), 1.0, (LEAST_TRUST + (1 - LEAST_TRUST) * narrow) * lit)


def cut_by_edges(near: SparseRows, camera: tuple[int, int], projector: tuple[int, int]) -> FloatArray:
    """s / m, (camera pixels,): how much of a footprint lies at an edge of the raster, which may cut it.

    s is the share of a row's light on the outermost line of the raster, m the largest share that one line has of the
    whole footprints nearby: next to 1 in focus, little where footprints are wide. A whole footprint that lies in the
    outermost line has 1, one that is cut more.

    near : T, (camera pixels, projector pixels).  camera, projector : (height, width).
    """
    shares = _Shares.of(near, camera, projector)
    across = _cut(shares, shares.x, projector[1]), _cut(shares, shares.y, projector[0])
    return np.asarray(np.maximum(*across))


def _cut(shares: _Shares, place: NDArray[np.int64], count: int) -> FloatArray:
    """s / m of two opposite edges; place : across them, of `count`."""
    pixels = shares.camera[0] * shares.camera[1]
    lines = sparse.csr_array((shares.share, (shares.rows, place)), shape=(pixels, count))
    lines.sum_duplicates()
    at_edge = _largest(lines[:, np.unique([0, count - 1])])
    return np.asarray(at_edge / _around(_largest(lines), at_edge < UNTOUCHED, shares.camera))


def _largest(lines: sparse.csr_array) -> FloatArray:
    """The largest entry of each row, (rows,)."""
    return np.asarray(lines.max(axis=1).toarray(), np.float64).ravel()


def _around(largest: FloatArray, untouched: NDArray[np.bool_], camera: tuple[int, int]) -> FloatArray:
    """The mean of `largest` over untouched footprints nearby, or where they are nearest; 1 if there are none."""
    whole = (untouched & (largest > 0)).reshape(camera)
    weight = ndimage.uniform_filter(whole.astype(np.float64), NEARBY, mode="constant")
    enough = weight > FEW
    if not enough.any():
        return np.ones(largest.size)
    total = ndimage.uniform_filter(np.where(whole, largest.reshape(camera), 0), NEARBY, mode="constant")
    nearest = ndimage.distance_transform_edt(~enough, return_distances=False, return_indices=True)
    return np.asarray((total / np.maximum(weight, FEW))[tuple(nearest)].ravel())


def seen(near: SparseRows, trusted: NDArray[np.bool_]) -> FloatArray:
    """How much of a projector pixel trusted camera pixels see, 1 where as much as of most: (projector pixels,).

    A camera pixel is seen to be made of projector pixels by its light's shares, whatever its paint: a projector pixel
    that makes up as many camera pixels as most do has 1. trusted : (camera pixels,).
    """
    shares = luminance(near.weights)
    total = np.bincount(near.rows, shares, near.shape[0])[near.rows]
    shares = np.divide(shares, total, out=np.zeros_like(shares), where=(total > 0) & trusted[near.rows])
    made = np.bincount(near.indices, shares, near.shape[1])
    most = made[made > FEW * made.max(initial=0.0)]
    return np.asarray(made / np.median(most) if most.size else made)

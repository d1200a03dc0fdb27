"""T by direct mapping: each camera pixel sees one cell of the Gray code (thesis 6.1, SmartProjector).

Cells to which no camera pixel decodes would stay dark: the camera is coarser there, or a bit was unsure. Such a hole is
assigned to the nearest decoded cell, and both share that cell's camera pixels. Their columns of T are parallel, so the
regularised inverse, which has the least norm, gives both the same drive. Clusters stay small, with one decoded cell
each, because a hole joins only one cell.
"""

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from counterlight.maps.row_map import SparseRows
from counterlight.tools.transport.transport import Transport

NOBODY = -1
Cells = TypeVar("Cells", bound=np.generic)


@dataclass(frozen=True)
class Mapping:
    """The cell that each camera pixel sees, and the cell that each projector pixel follows.

    seen_cell : (camera pixels,) int64. Cell index x + y · columns; NOBODY for invalid camera pixels.
    owner : (projector pixels,) int64. The decoded cell that a projector pixel belongs to; NOBODY if none is near.
    decoded : (projector pixels,) bool. False for filled holes.
    """

    seen_cell: NDArray[np.int64]
    owner: NDArray[np.int64]
    decoded: NDArray[np.bool_]


def direct_mapping(
    x: NDArray[np.int32],
    y: NDArray[np.int32],
    valid: NDArray[np.bool_],
    projector: tuple[int, int],
    *,
    step: int = 1,
    fill_radius: int = 0,
) -> Mapping:
    """Make the mapping of decoded coordinates.

    x, y, valid : (camera height, camera width). Coordinates in cells, and whether they count.
    projector : (height, width) in pixels.
    step : side of a cell in projector pixels.
    fill_radius : in cells; see `cell_owners`.
    """
    rows, columns = (-(-side // step) for side in projector)
    seen_cell = np.where(valid, x + np.int64(columns) * y, NOBODY).ravel()
    decoded = np.zeros((rows, columns), np.bool_)
    decoded[y[valid], x[valid]] = True
    owner = cell_owners(decoded, fill_radius)
    return Mapping(seen_cell, _on_pixels(owner, projector, step), _on_pixels(decoded, projector, step))


def cell_owners(decoded: NDArray[np.bool_], fill_radius: int) -> NDArray[np.int64]:
    """Returns the index of the nearest decoded cell for each cell; NOBODY for cells that are not between decoded cells.

    A cell is between decoded cells if it is in their morphological closing by a disc of `fill_radius` cells. Gaps up to
    twice that width are filled, and the outline of the decoded cells does not grow.
    """
    if not decoded.any():
        return np.full(decoded.shape, NOBODY)
    index = np.arange(decoded.size).reshape(decoded.shape)
    margin = fill_radius + 1  # a margin, so that the edge neither cuts the dilation off nor counts as decoded
    distance, nearest = ndimage.distance_transform_edt(~np.pad(decoded, margin), return_indices=True)
    closed = ndimage.distance_transform_edt(distance <= fill_radius) > fill_radius
    owner = np.where(closed, np.pad(index, margin)[tuple(nearest)], NOBODY)
    return np.asarray(owner[margin:-margin, margin:-margin], np.int64)


def direct_transport(mapping: Mapping, weight: NDArray[np.float32]) -> Transport:
    """Make T with row sums `weight`, spread evenly over the projector pixels of the cell that each camera pixel sees.

    T_iq = weight_i / n if projector pixel q is one of the n that follow the cell that camera pixel i sees.

    weight : (camera pixels, 3) ≥ 0, white − black.
    """
    shape = mapping.seen_cell.size, mapping.owner.size
    followers = np.flatnonzero(mapping.owner != NOBODY)
    order = followers[np.argsort(mapping.owner[followers], kind="stable")]
    counts = np.bincount(mapping.owner[followers], minlength=int(mapping.seen_cell.max(initial=0)) + 1)
    starts = np.concatenate([[0], np.cumsum(counts)])
    counting = np.flatnonzero(mapping.seen_cell != NOBODY)
    cells = mapping.seen_cell[counting]
    lengths = np.zeros(shape[0], np.int64)
    lengths[counting] = counts[cells]
    indptr = np.concatenate([[0], np.cumsum(lengths)])
    within = np.arange(indptr[-1]) - np.repeat(indptr[counting], counts[cells])
    indices = order[np.repeat(starts[cells], counts[cells]) + within]
    share = weight[counting] / counts[cells][:, None]
    entries = np.repeat(share, counts[cells], axis=0).astype(np.float32)
    return Transport(SparseRows(indptr, indices, entries, shape[1]))


def _on_pixels(cells: NDArray[Cells], projector: tuple[int, int], step: int) -> NDArray[Cells]:
    """Repeat each cell over its step × step projector pixels, cut off at the projector's edge; flattened."""
    height, width = projector
    return cells.repeat(step, axis=0).repeat(step, axis=1)[:height, :width].ravel()

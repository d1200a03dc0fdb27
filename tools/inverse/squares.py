"""A few squares of the camera's picture that stand for all of it, where the whole would take minutes.

λ and the steps that a room needs are means over the picture: five squares give them (docs/size.md).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import BoolArray, IntArray
from counterlight.tools.transport.transport import Csr

SIDE, SMALLEST_SIDE = 96, 24
MOST_ENTRIES = 1 << 21  # of T in all squares
BORDER = 8  # pixels of a square that stand for what lies beside it
CENTRES = ((0.5, 0.5), (0.25, 0.25), (0.25, 0.75), (0.75, 0.25), (0.75, 0.75))


@dataclass(frozen=True)
class Squares:
    """Camera pixels of some squares, ascending.

    rows : (n,).  inner : (n,), those that do not stand at a square's border.
    """

    rows: IntArray
    inner: BoolArray

    def compact(self, T: Csr, columns: IntArray) -> Csr:
        """T of these camera pixels, and of those projector pixels only."""
        return Csr(T[self.rows][:, columns])

    def columns(self, T: Csr) -> IntArray:
        """Projector pixels that light them, ascending."""
        return np.unique(T[self.rows].indices).astype(np.int64)


def squares_of(mask: NDArray[np.bool_], entries: int) -> Squares:
    """Squares of at most 96 pixels a side in the mask's bounding box, smaller where T is dense.

    mask : (camera height, camera width), where any pixel counts.  entries : of T, of one channel.
    """
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    top, left, height, width = rows[0], columns[0], int(np.ptp(rows)) + 1, int(np.ptp(columns)) + 1
    density = entries / max(int(np.count_nonzero(mask)), 1)
    side = int(np.clip(np.sqrt(MOST_ENTRIES / (len(CENTRES) * max(density, 1))), SMALLEST_SIDE, SIDE))
    chosen, inner = np.zeros(mask.shape, bool), np.zeros(mask.shape, bool)
    for down, across in CENTRES:
        y, x = (
            int(start + share * max(extent - side, 0))
            for start, share, extent in ((top, down, height), (left, across, width))
        )
        chosen[y : y + side, x : x + side] = True
        inner[_inner(y, side, mask.shape[0]), _inner(x, side, mask.shape[1])] = True
    if not (chosen & mask).any():
        chosen, inner = np.ones_like(mask), np.ones_like(mask)
    found = np.flatnonzero((chosen & mask).ravel())
    within = inner.ravel()[found]
    return Squares(found, within if within.any() else np.ones_like(within))


def _inner(start: int, side: int, extent: int) -> slice:
    """Along an axis, without the border, which the picture's own edge has none of."""
    return slice(start + BORDER if start > 0 else 0, start + side - BORDER if start + side < extent else extent)

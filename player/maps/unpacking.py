"""Rows of a packed map one after the other, compiled: a player that draws on the processor does so at its start."""

import numba
import numpy as np
from numpy.typing import NDArray

from counterlight.maps.products import kept


@kept(parallel=True, error_model="numpy")
def unpack_entries(
    lookup: NDArray[np.uint32],
    entries: NDArray[np.float32],
    index: NDArray[np.uint32],
    indptr: NDArray[np.int64],
    indices: NDArray[np.int32],
    weights: NDArray[np.float32],
) -> None:
    """Fill the indices and weights of every row.

    lookup : (rows, 3). Column and line of a row's first texel, and its length.
    entries : (lines, width, 4). Three weights, and the source pixel where `index` is empty.
    index : (lines, width), or (0, 0). The source pixel.
    indptr : (rows + 1,). Where each row begins among all entries.
    """
    for row in numba.prange(lookup.shape[0]):
        x, y, first = lookup[row, 0], lookup[row, 1], indptr[row]
        for k in range(indptr[row + 1] - first):
            texel = entries[y, x + k]
            for channel in range(3):
                weights[first + k, channel] = texel[channel]
            indices[first + k] = index[y, x + k] if index.size else np.int32(texel[3])

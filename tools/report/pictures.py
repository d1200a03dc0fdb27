"""Measured data as 8-bit pictures (rows, columns, 3)."""

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray, IntArray
from counterlight.maps.row_map import RowMap
from counterlight.passes.colour import LUMINANCE
from counterlight.tools.transport.transport import Csr, Transport, channel_of_chain, luminance_matrix

Picture = NDArray[np.uint8]
MATRIX_SIDE = 512
TEXTURE_SIDE = 512
GOLDEN = 0.6180339887  # gives successive labels very different hues
UNCONNECTED = (40, 40, 40)


def cluster_picture(labels: IntArray, shape: tuple[int, int]) -> Picture:
    """Draw each cluster in its own colour; pixels without connections are dark (thesis Figure 4.6)."""
    numbers = np.arange(max(int(labels.max(initial=-1)), 0) + 1)
    value = 0.7 + 0.3 * ((numbers * GOLDEN**2) % 1)
    # HSV with saturation 0.6; each channel is a trapezoid over the hue.
    hue = (numbers[:, None] * GOLDEN + np.array([0, 2 / 3, 1 / 3])) % 1
    ramp = np.clip(np.abs(6 * hue - 3) - 1, 0, 1)
    palette = np.round(255 * value[:, None] * (0.4 + 0.6 * ramp)).astype(np.uint8)
    picture: Picture = palette[np.maximum(labels, 0)]
    picture[labels < 0] = UNCONNECTED
    return picture.reshape(*shape, 3)


def matrix_picture(matrix: Csr) -> Picture:
    """Draw a matrix as density: each pixel sums |entries| of a block, on a logarithmic scale of 4 decades."""
    return _decades(_block_sums(matrix))


def transport_picture(T: Transport) -> Picture:
    """Draw T's luminance as density, near, blurred and far light (thesis Figure 5.3), as `matrix_picture`.

    Chains are summed through their factors: Rᵀ U M D C. R and C map pixels to blocks.
    """
    sums, (rows, columns) = _block_sums(luminance_matrix(T.near)), (_blocks(side) for side in T.shape)
    for chain in T.chains:
        for i, weight in enumerate(LUMINANCE):
            each = channel_of_chain(chain, i)
            spread, cells = each.gather @ columns.T, rows @ each.scatter
            sums += weight * ((cells @ spread).toarray() if each.mix is None else (cells @ each.mix) @ spread.toarray())
    return _decades(sums)


def _block_sums(matrix: Csr) -> FloatArray:
    rows, columns = (_blocks(side) for side in matrix.shape)
    return np.asarray((rows @ abs(matrix) @ columns.T).toarray(), np.float64)


def _blocks(side: int) -> Csr:
    """Returns the block of each pixel as a matrix of ones (blocks, pixels), with at most MATRIX_SIDE blocks."""
    count = min(side, MATRIX_SIDE)
    block = np.arange(side, dtype=np.int64) * count // side
    return Csr((np.ones(side), (block, np.arange(side))), shape=(count, side))


def _decades(sums: FloatArray) -> Picture:
    largest = float(sums.max(initial=0.0)) or 1.0
    return _grey(np.log10(np.maximum(sums / largest, 1e-4)) / 4 + 1)


def texture_picture(packed: RowMap) -> Picture:
    """Draw the used texels of the entries texture: white where a block is full, black where it is unused."""
    height, width = packed.entries.shape[:2]
    x, y, lengths = (packed.lookup[..., i].ravel().astype(np.int64) for i in range(3))
    edges = np.zeros((height, width + 1), np.int64)  # +1 where a row of the matrix starts, −1 after its end
    used = lengths > 0
    np.add.at(edges, (y[used], x[used]), 1)
    np.add.at(edges, (y[used], x[used] + lengths[used]), -1)
    return _grey(_block_means(np.cumsum(edges, axis=1)[:, :width].astype(np.float64)))


def _block_means(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the averages over blocks, at most 512 per side."""
    for axis in (0, 1):
        length = values.shape[axis]
        starts = np.unique(np.arange(min(length, TEXTURE_SIDE)) * length // min(length, TEXTURE_SIDE))
        counts = np.diff(starts, append=length)
        values = np.add.reduceat(values, starts, axis=axis) / np.expand_dims(counts, 1 - axis)
    return values


def _grey(share: NDArray[np.float64]) -> Picture:
    return np.repeat(np.round(255 * np.clip(share, 0, 1)).astype(np.uint8)[..., None], 3, axis=2)

"""A large cluster inverted through overlapping windows of the projector picture.

Rows of a damped inverse decay: what a projector pixel needs to know lies within a few pixels around it. So each block
of pixels solves the normal equations of a window, the block and a halo, and keeps the block's rows. The halo grows
until a wider one no longer changes compensated pictures (docs/mathematics.md 2; Demko 1984 on such decay).
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import cho_factor, cho_solve

from tools.inverse.pictures import typical_pictures
from tools.inverse.pieces import Piece, truncated_piece
from tools.transport.transport import Csr

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BLOCKS = (16, 8, 4, 2, 1)
BLOCK_VALUES = 1 << 24  # float64 values of one block's rows, three channels (128 MiB)
HALOS = (4, 6, 8, 12, 16, 24)
SAMPLE_WINDOWS = 5


class WindowedChannel:
    """One colour channel of a large cluster: T by columns and the normal matrix TᵀT + λ²I, from which windows are cut.

    T : (camera pixels, projector pixels).  damping : λ > 0.
    """

    def __init__(self, T: Csr, damping: float) -> None:
        wide = T.astype(np.float64)
        self.camera_pixels = int(np.count_nonzero(np.diff(T.indptr)))
        self._columns = sparse.csc_array(wide)
        self._normal = sparse.csr_array(wide.T @ wide + damping**2 * sparse.eye_array(T.shape[1]))

    def rows(self, block: IntArray, window: IntArray) -> tuple[IntArray, FloatArray]:
        """Rows `block` of T⁺ computed on `window` ⊇ block (sorted projector pixels).

        Returns the camera pixels (m,), ascending, and the rows (block pixels, m).
        """
        factor = cho_factor(self._normal[window][:, window].toarray(), lower=True, overwrite_a=True, check_finite=False)
        unit = np.zeros((window.size, block.size))
        unit[np.searchsorted(window, block), np.arange(block.size)] = 1
        solution = cho_solve(factor, unit, overwrite_b=True, check_finite=False)
        local = self._columns[:, window]
        camera, place = np.unique(local.indices, return_inverse=True)
        compact = sparse.csc_array((local.data, place, local.indptr), shape=(camera.size, window.size))
        return camera.astype(np.int64), (compact @ solution).T


@dataclass(frozen=True)
class Windows:
    """How a large cluster is cut: its pixels as a picture (label or not), the blocks' side and the halo around them."""

    member: NDArray[np.bool_]
    halo: int
    block: int

    def blocks(self) -> list[tuple[int, int]]:
        """Upper left corners (row, column) of the blocks that hold any pixel of the cluster."""
        height, width = self.member.shape
        corners = [(y, x) for y in range(0, height, self.block) for x in range(0, width, self.block)]
        return [(y, x) for y, x in corners if self.member[y : y + self.block, x : x + self.block].any()]

    def pixels(self, corner: tuple[int, int], halo: int) -> IntArray:
        """Projector pixels of the cluster in the block at `corner` widened by `halo`, ascending."""
        y, x = corner
        rows = slice(max(y - halo, 0), y + self.block + halo)
        columns = slice(max(x - halo, 0), x + self.block + halo)
        inside_y, inside_x = np.nonzero(self.member[rows, columns])
        return np.asarray((inside_y + rows.start) * self.member.shape[1] + inside_x + columns.start, np.int64)


def choose_halo(
    channel: WindowedChannel, member: NDArray[np.bool_], camera_shape: tuple[int, int], white: float, tolerance: float
) -> tuple[Windows, float]:
    """The smallest halo that a wider one would change by at most `tolerance` (drive), measured on a few windows.

    member : (projector height, projector width).  Returns the windows and the change that was measured.
    """
    pictures = white * np.stack([picture.ravel() for picture in typical_pictures(camera_shape)], axis=1)
    block = _block_side(member, channel.camera_pixels)
    corners = Windows(member, 0, block).blocks()
    sample = [corners[i] for i in np.linspace(0, len(corners) - 1, SAMPLE_WINDOWS + 2).astype(int)[1:-1]]
    sample = list(dict.fromkeys(sample))
    change = np.inf
    previous = _compensate(channel, Windows(member, HALOS[0], block), sample, pictures)
    for halo, wider in pairwise(HALOS):
        following = _compensate(channel, Windows(member, wider, block), sample, pictures)
        change = max(float(np.max(np.abs(a - b))) for a, b in zip(previous, following, strict=True))
        if change <= tolerance:
            return Windows(member, halo, block), change
        previous = following
    return Windows(member, HALOS[-1], block), change


def _block_side(member: NDArray[np.bool_], camera_pixels: int) -> int:
    """The largest side whose rows, over all camera pixels that a window sees, stay within memory."""
    density = camera_pixels / np.count_nonzero(member)
    for side in BLOCKS:
        seen = min(density * (side + 2 * HALOS[-1]) ** 2, camera_pixels)
        if 3 * side**2 * seen <= BLOCK_VALUES:
            return side
    return BLOCKS[-1]


def windowed_jobs(
    channels: tuple[WindowedChannel, ...], windows: Windows, reach: FloatArray, budget: float
) -> Iterator[Callable[[], Piece]]:
    """Jobs that invert one block of projector pixels each."""
    for corner in windows.blocks():
        block, window = windows.pixels(corner, 0), windows.pixels(corner, windows.halo)
        yield partial(_invert, channels, block, window, reach, budget)


def _invert(
    channels: tuple[WindowedChannel, ...], block: IntArray, window: IntArray, reach: FloatArray, budget: float
) -> Piece:
    parts = [channel.rows(block, window) for channel in channels]
    camera = np.unique(np.concatenate([columns for columns, _ in parts]))
    blocks = np.zeros((len(parts), block.size, camera.size))
    for blocks_of_channel, (columns, rows) in zip(blocks, parts, strict=True):
        blocks_of_channel[:, np.searchsorted(camera, columns)] = rows
    columns_of_rows = np.broadcast_to(camera, (block.size, camera.size))
    return truncated_piece(block, columns_of_rows, blocks, reach, budget)


def _compensate(
    channel: WindowedChannel, windows: Windows, corners: list[tuple[int, int]], pictures: FloatArray
) -> list[FloatArray]:
    results = []
    for corner in corners:
        camera, rows = channel.rows(windows.pixels(corner, 0), windows.pixels(corner, windows.halo))
        results.append(np.clip(rows @ pictures[camera], 0, 1))
    return results

"""Windows inverted on other machines: each super-block reads its own slice of T from a shared folder.

A slice holds everything that the windows of a super-block can use: the columns of T, and N's rows and columns, of the
pixels that their widest windows touch. Values and their order are as in the whole, so the result is identical to the
last bit.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse

from counterlight.arrays import IntArray
from counterlight.command import track
from counterlight.jobs.workers import Workers
from counterlight.raster import Region
from counterlight.tools.inverse.rows import Piece, Truncation
from counterlight.tools.inverse.windows import HALOS, WindowedChannel, WindowRows, Windows, windowed_jobs
from counterlight.tools.jobs import one_thread

SIDE = 4  # blocks per side of a super-block
MATRICES = "columns", "normal"
PARTS = "data", "indices", "indptr"
SHARED, REACH = "windows.npz", "reach.npy"


@dataclass(frozen=True)
class Elsewhere:
    """Inverts windows with other workers. folder : an empty folder for the slices, which all workers can read."""

    workers: Workers
    folder: Path

    def pieces(
        self, channels: Sequence[WindowedChannel], windows: Windows, truncation: Truncation, tolerance: float
    ) -> Iterator[Piece]:
        """Invert all windows on the workers; takes and gives the same as `windowed_jobs`."""
        np.save(self.folder / REACH, truncation.reach)
        regions = np.array([tuple(region) for region in windows.regions], np.int64).reshape(-1, 4)
        np.savez(self.folder / SHARED, member=windows.member, sizes=[windows.halo, windows.block], regions=regions)
        groups = _super_blocks(windows)
        for number, corners in enumerate(groups):
            slices = [_slice(channel, windows, corners) for channel in channels]
            named = {f"{i}_{name}": values for i, each in enumerate(slices) for name, values in each.items()}
            np.savez(self.folder / f"{number}.npz", corners=np.array(corners, np.int64), **named)
        sizes = truncation.budget, tolerance, len(channels)
        jobs = [partial(invert_super_block, self.folder, number, *sizes) for number in range(len(groups))]
        for _, pieces in track(self.workers.completed(jobs), "inverting", len(jobs)):
            yield from pieces


def invert_super_block(folder: Path, number: int, budget: float, tolerance: float, channels: int) -> list[Piece]:
    """Invert the windows of one super-block; runs on a worker."""
    whole, reach = _windows(folder), np.load(folder / REACH, mmap_mode="r")
    with np.load(folder / f"{number}.npz") as stored:
        slices = tuple(_Slice(stored, i) for i in range(channels))
        corners = [(int(y), int(x)) for y, x in stored["corners"]]
    jobs = windowed_jobs(slices, whole, Truncation(reach, budget), tolerance, corners)
    # one thread, as tools/jobs.py uses, so that results are identical to the last bit
    with one_thread():
        return [job() for job in jobs]


class _Slice(WindowedChannel):
    """A channel with only some projector pixels, which keep their numbers in the whole."""

    def __init__(self, stored: Any, channel: int) -> None:
        self._pixels: IntArray = stored[f"{channel}_pixels"]
        (columns, wide), (normal, square) = (
            (tuple(stored[f"{channel}_{name}_{part}"] for part in PARTS), tuple(stored[f"{channel}_{name}_shape"]))
            for name in MATRICES
        )
        self._columns = sparse.csc_array(columns, shape=wide)
        self._normal = sparse.csr_array(normal, shape=square)

    def solve(self, block: IntArray, window: IntArray) -> WindowRows:
        return super().solve(np.searchsorted(self._pixels, block), np.searchsorted(self._pixels, window))

    def touched(self, block: IntArray) -> IntArray:
        return self._pixels[super().touched(np.searchsorted(self._pixels, block))]


def _slice(channel: WindowedChannel, windows: Windows, corners: Sequence[tuple[int, int]]) -> dict[str, Any]:
    widest = np.unique(np.concatenate([windows.window(channel, corner, HALOS[-1]) for corner in corners]))
    pixels = channel.touched(widest)
    found = {"pixels": pixels}
    for name, matrix in zip(MATRICES, channel.part(pixels), strict=True):
        found |= {f"{name}_{part}": getattr(matrix, part) for part in (*PARTS, "shape")}
    return found


def _super_blocks(windows: Windows) -> list[list[tuple[int, int]]]:
    """Return the corners of all blocks, grouped by proximity."""
    side, groups = SIDE * windows.block, dict[tuple[int, int], list[tuple[int, int]]]()
    for y, x in windows.blocks():
        groups.setdefault((y // side, x // side), []).append((y, x))
    return list(groups.values())


@lru_cache(1)
def _windows(folder: Path) -> Windows:
    with np.load(folder / SHARED) as stored:
        halo, block = map(int, stored["sizes"])
        return Windows(stored["member"], halo, block, tuple(Region(*map(int, each)) for each in stored["regions"]))

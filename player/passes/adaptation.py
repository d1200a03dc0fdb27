"""The scale and offset that adapt a frame to the room (pipeline/content.py states the goal)."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from counterlight.passes.drawing import Array
from counterlight.passes.kernel import PICTURE, Whole, kernel, prange

PERCENT = 0.01
SUMS_SHADER, CHOICE_SHADER = "clip_sums.frag", "choose.frag"
SCALES = np.linspace(1, 0.25, 16)  # candidates of s / (1 − o), the preferred first
OFFSETS = 0.25 * np.linspace(0, 1, 16) ** 2  # candidates of o, in shares of white
TILES, SAMPLES = 16, 16  # the camera's view is summed in 16 × 16 tiles of at most 16 × 16 samples
FloatArray = NDArray[np.floating]


@dataclass(frozen=True)
class Limits:
    """The light that a room allows each camera pixel; see pipeline/content.py for the symbols.

    near_white : (camera height, camera width, 3). 1 − F 1.
    near_ambient : (camera height, camera width, 3). e − F e.
    ambient : (camera height, camera width, 3). e.
    most : (camera height, camera width, 4). S·1; the fourth channel is 0 for pixels that do not count.
    """

    near_white: Array
    near_ambient: Array
    ambient: Array
    most: Array


def clip_sums(
    u: Array, near: Array, limits: Limits, white: float, budget: float, offset: float | None
) -> NDArray[np.float64]:
    """Return how much more light is clipped than the budget allows, for 16 candidates.

    u : (camera height, camera width, 3). The target in shares of white.
    near : (camera height, camera width, 3). u − F u.
    budget : share of A that may be clipped.
    offset : o, for which all scales are tried. None tries the offsets with s = 1 − o, and counts only light below 0.

    Returns (16,), summed over the samples.
    """
    (offsets, shares), sums = tried(offset), np.empty(16)
    pace = np.float32(white), np.float32(budget), offsets, shares, offset is not None
    sums_of_candidates(u, near, *vars(limits).values(), *samples(u.shape[:2]), *pace, sums)
    return sums


def tried(offset: float | None) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return o and s / (1 − o) of the 16 candidates, (16,) each."""
    return (OFFSETS, np.ones(16)) if offset is None else (np.full(16, offset), SCALES)


def samples(shape: tuple[int, int]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the rows and columns of a picture (height, width) that enter the sums."""
    return tuple(map(_along, shape, *tile_grid(shape)))  # type: ignore[return-value]


def _along(length: int, tile: int, step: int) -> NDArray[np.int64]:
    starts = range(0, length, tile)
    return np.concatenate([np.arange(start, min(start + tile, length), step) for start in starts])


def tile_grid(shape: tuple[int, int]) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return (rows, columns) of a tile in pixels, and the (row, column) distance between samples within a tile."""
    tile = -(-shape[0] // TILES), -(-shape[1] // TILES)
    return tile, (-(-tile[0] // SAMPLES), -(-tile[1] // SAMPLES))


def choose(candidates: FloatArray, sums: FloatArray, otherwise: int) -> float:
    """Return the first candidate whose sum is at most 0, interpolated towards its predecessor.

    otherwise : index of the candidate to return if no sum is at most 0.
    """
    within = np.flatnonzero(sums <= 0)
    if not within.size:
        return float(candidates[otherwise])
    i = within[0]
    if i == 0:
        return float(candidates[0])
    share = sums[i - 1] / (sums[i - 1] - sums[i])
    return float(candidates[i - 1] + share * (candidates[i] - candidates[i - 1]))


def tone_of(u: Array, near: Array, limits: Limits, white: float, budget: float) -> NDArray[np.float64]:
    """Return the scale s and the offset o that adapt one picture to the room."""
    sums = clip_sums(u, near, limits, white, budget / 2, None)
    offset = choose(OFFSETS, sums, len(OFFSETS) - 1)
    sums = clip_sums(u, near, limits, white, budget, offset)
    return np.array([(1 - offset) * choose(SCALES, sums, int(np.argmin(sums))), offset])


@kernel(
    f"{', '.join([PICTURE] * 6)}, int64[::1], int64[::1], float32, float32, "
    "float64[::1], float64[::1], boolean, float64[::1]"
)
def sums_of_candidates(
    u: Array,
    near: Array,
    near_white: Array,
    near_ambient: Array,
    ambient: Array,
    most: Array,
    rows: Whole,
    columns: Whole,
    white: Any,
    budget: Any,
    offsets: NDArray[np.float64],
    shares: NDArray[np.float64],
    bright: Any,
    out: NDArray[np.float64],
) -> None:
    """Compute the clipped light above the budget for each candidate.

    bright : whether light above the maximum counts, too.
    """
    for i in prange(out.size):
        o, share, total = np.float32(offsets[i]), np.float32((1 - offsets[i]) * shares[i]), 0.0
        for y in rows:
            for x in columns:
                if most[y, x, 3] > 0:
                    for c in range(3):
                        needed = white * (share * near[y, x, c] + o * near_white[y, x, c]) - near_ambient[y, x, c]
                        clipped = max(-needed, np.float32(0))
                        if bright:
                            clipped += max(needed - most[y, x, c], np.float32(0))
                        total += clipped - budget * max(white * u[y, x, c], ambient[y, x, c])
        out[i] = total

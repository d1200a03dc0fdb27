"""Where a picture stands below the best one, estimated: its squares solved to the end, or a sample of them.

A certificate (refinement.py) is a bound, and far from the truth. Errors that steps leave are of high frequency, for the
low ones go first: a square that is solved with its surroundings held beyond a halo (squares.py) gains what it would
gain among the others, to a few percent. Where the maps are too large for all squares, some are drawn by lot, rather
those where one step would gain much, and what they gain is divided by their chances.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from counterlight.maps.room_maps import RefinementMaps
from counterlight.pipeline.reference import block_sum, pull
from counterlight.pipeline.shortfall import Shortfall, Snapshot
from counterlight.pipeline.squares import MOST_STEPS, TO_THE_END, Square, descend, square_of

Picture = NDArray[np.float32]
SIDE, HALO = 32, 8  # of a square, and what is solved around it, projector pixels
MOST_ENTRIES = 4_000_000  # of TᵀW that an estimate reads: a few seconds of one core
FEWEST = 12  # squares, however many entries they have
FAINTEST = 1e-6  # of white²: an error 60 dB below white counts as none


class Survey:
    """Estimates, picture by picture, for one room.  white : radiance of a white picture."""

    def __init__(self, maps: RefinementMaps, white: float) -> None:
        self._maps = maps
        self._floor = FAINTEST * white**2 * 3 * float(maps.weights.sum(dtype=np.float64))
        entries = block_sum(maps.dual.lookup[..., 2].astype(np.int64), SIDE)
        self._shape, self._entries = entries.shape, int(entries.sum() * (1 + 2 * HALO / SIDE) ** 2)
        self._whole = self._entries <= MOST_ENTRIES
        self._square = lru_cache(maxsize=None if self._whole else 0)(self._cut_out)
        self._lots = np.random.default_rng(0)

    def of(self, snapshot: Snapshot) -> Shortfall:
        """The estimate; takes a second or two of one core, most of it without Python's lock."""
        prior, p = self._maps.prior, snapshot.drive
        slope = snapshot.descent - pull(p, prior.damping, prior.right, prior.down).astype(np.float32)
        promised = block_sum(_promise(p, slope, self._maps.step_size), SIDE).ravel()
        chances = self._chances(np.array(promised, np.float64))
        drawn, lots = self._draw(chances)
        found = np.array([self._gains(snapshot, slope, int(square)) for square in drawn]).reshape(-1, 2)
        each = np.repeat(found / chances[drawn, None], lots, axis=0)
        error = float(snapshot.certificate.error.sum())
        least, doubled = (max(error - gain, 0.0) for gain in each.mean(axis=0))
        return Shortfall(
            max(self._ratio_db(error, least), 0.0),
            self._ratio_db(error, doubled),
            snapshot.steps,
            len(drawn),
            len(chances),
            0.0 if self._whole else _relative_error(each[:, 0]),
        )

    def _chances(self, promised: NDArray[np.float64]) -> NDArray[np.float64]:
        """Of each square in one lot: the same for all, or half of it in proportion to what a step would gain there."""
        alike, total = np.full(promised.size, 1 / promised.size), promised.sum()
        return alike if self._whole or not total > 0 else (alike + promised / total) / 2

    def _draw(self, chances: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Numbers of squares, and how often each was drawn, in steps of equal chance."""
        if self._whole:
            return np.arange(chances.size), np.ones(chances.size, np.int64)
        count = max(MOST_ENTRIES * chances.size // self._entries, FEWEST)
        at = (np.arange(count) + self._lots.uniform()) / count
        drawn = np.searchsorted(np.cumsum(chances), at, side="right")
        return np.unique(np.minimum(drawn, chances.size - 1), return_counts=True)

    def _gains(self, snapshot: Snapshot, slope: Picture, number: int) -> tuple[float, float]:
        """What Σ w (T p − b)² loses in a square solved to the end, and by as many steps again."""
        part, inner = self._part(number)
        square = self._square(number)
        p, y, d, s = (
            np.ascontiguousarray(picture[part], np.float64)
            for picture in (snapshot.drive, snapshot.ahead, snapshot.descent, slope)
        )
        ended = descend(square, p, s, np.zeros_like(p), TO_THE_END, MOST_STEPS)
        again = descend(square, p, s, y - p, snapshot.made, max(snapshot.steps, 1))
        least, further = (float(np.sum((change * (2 * d - lit))[inner])) for change, lit, _ in (ended, again))
        return least, further

    def _part(self, number: int) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
        """A square with its halo, and where in that the square is."""
        outer, inner = [], []
        for at, length in zip(divmod(number, self._shape[1]), self._maps.dual.output_shape, strict=True):
            first, last = SIDE * at, min(SIDE * (at + 1), length)
            outer.append(slice(max(first - HALO, 0), min(last + HALO, length)))
            inner.append(slice(first - outer[-1].start, last - outer[-1].start))
        return (outer[0], outer[1]), (inner[0], inner[1])

    def _cut_out(self, number: int) -> Square:
        return square_of(self._maps, self._part(number)[0])

    def _ratio_db(self, error: float, less: float) -> float:
        return float(10 * np.log10((error + self._floor) / (less + self._floor)))


def _promise(p: Picture, slope: Picture, step: Picture) -> NDArray[np.float64]:
    """What one step would gain of the objective at least, pixel by pixel, all channels: (height, width)."""
    change = np.clip(p + step * slope, 0, 1) - p
    curved = np.divide(change**2, step, out=np.zeros_like(change), where=step > 0)
    return np.asarray(np.sum(slope * change * (step > 0) - curved / 2, axis=2, dtype=np.float64))


def _relative_error(ratios: NDArray[np.float64]) -> float:
    mean = ratios.mean() if ratios.size else 0.0
    return float(ratios.std(ddof=1) / np.sqrt(ratios.size) / mean) if mean > 0 and ratios.size > 1 else 0.0

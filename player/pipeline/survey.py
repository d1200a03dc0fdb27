"""Where a picture stands below the unweighted optimum, estimated: its squares solved to the end, or a sample of them.

A certificate (refinement.py) is a bound, and far from the truth. Errors that steps leave are of high frequency, for the
low ones go first: a square that is solved with its surroundings held beyond a halo (squares.py) gains what it would
gain among the others, to a few percent. Where the maps are too large for all squares, some are drawn by lot, rather
those where one step would gain much, and what they gain is divided by their chances.

For far light squares change together, which none of them knows of. So their changes go through it at last, and as much
of them is taken as is best for all: α ≤ 1 of a change δ gains 2 α dᵀδ − α² ‖T δ‖², T with far light. The error is the
unweighted one over the lit camera pixels, d = Tᵀ (b − T p). Steps seek what refinement seeks, and this error judges
them.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from counterlight.maps.room_maps import RoomMaps
from counterlight.pipeline.operators import chained
from counterlight.pipeline.reference import block_sum, pull
from counterlight.pipeline.shortfall import Shortfall, Snapshot
from counterlight.pipeline.squares import (
    MOST_STEPS,
    TO_THE_END,
    Square,
    descend,
    seen_change,
    square_of,
    unweighted,
)

FloatArray = NDArray[np.float64]
Picture = NDArray[np.float32]
Part = tuple[slice, slice]
SIDE, HALO = 32, 8  # of a square, and what is solved around it, projector pixels
MOST_ENTRIES = 4_000_000  # of TᵀW that an estimate reads: a few seconds of one core
FEWEST = 12  # squares, however many entries they have
FAINTEST = 1e-6  # of white²: an error 60 dB below white counts as none


@dataclass(frozen=True)
class _Change:
    """What a square, without its halo, would have changed, (height, width, 3).

    square : of the unweighted error.  outer : with the halo, in the projector's picture.  inner : the square in that.
    weight : how many it stands for.  lit : TᵀT of the change and its halo's, of near light.
    """

    square: Square
    outer: Part
    inner: Part
    weight: float
    change: FloatArray
    lit: FloatArray

    def along(self, picture: NDArray[np.floating]) -> float:
        """Its inner product with a picture of the outer part."""
        return float(np.sum((self.change * picture)[self.inner]))


class Survey:
    """Estimates, picture by picture, for one room that has the maps of refinement.  white : radiance of a white one."""

    def __init__(self, maps: RoomMaps, white: float) -> None:
        assert maps.refinement is not None
        self._maps, self._far = maps.refinement, chained(maps.far)
        self._floor = FAINTEST * white**2 * 3 * float(self._maps.lit.sum(dtype=np.float64))
        entries = block_sum(self._maps.dual.lookup[..., 2].astype(np.int64), SIDE)
        self._shape, self._entries = entries.shape, int(entries.sum() * (1 + 2 * HALO / SIDE) ** 2)
        self._whole = self._entries <= MOST_ENTRIES
        self._squares: dict[int, tuple[Square, Square]] = {}  # kept where all are solved every time
        self._lots = np.random.default_rng(0)

    def of(self, snapshot: Snapshot) -> Shortfall:
        """The estimate; takes a second or two of one core, most of it without Python's lock."""
        prior, p = self._maps.prior, snapshot.drive
        slope = snapshot.descent - pull(p, prior.damping, prior.right, prior.down).astype(np.float32)
        promised = block_sum(_promise(p, slope, self._maps.step_size), SIDE).ravel()
        drawn = self._draw(self._chances(np.array(promised, np.float64)))
        solved = [self._solve(snapshot, slope, *each) for each in drawn]
        error, descent = float(snapshot.certificate.squared_error.sum()), snapshot.unweighted
        best, again = ([pair[i] for pair in solved] for i in range(2))
        least = max(error - self._gain(best, descent, shortened=True), 0.0)
        doubled = max(error - self._gain(again, descent, shortened=False), 0.0)
        return Shortfall(
            max(self._ratio_db(error, least), 0.0),
            self._ratio_db(error, doubled),
            snapshot.steps,
            len(drawn),
            promised.size,
            0.0 if self._whole else _relative_error(best, descent),
        )

    def _gain(self, changes: list[_Change], descent: Picture, *, shortened: bool) -> float:
        """What Σ (T p − b)² loses by all changes; shortened : or by the best share of them."""
        along = sum(each.weight * each.along(descent[each.outer]) for each in changes)
        bent = sum(each.weight * each.along(each.lit) for each in changes) + self._bent_by_far_light(changes)
        share = min(max(along / bent, 0.0), 1.0) if shortened and bent > 0 else 1.0
        return float(2 * share * along - share**2 * bent)

    def _bent_by_far_light(self, changes: list[_Change]) -> float:
        """‖T δ‖² less that of the near light."""
        if self._far is None:
            return 0.0
        drive = np.zeros((*self._maps.dual.output_shape, 3))
        for each in changes:
            drive[each.outer][each.inner] = each.weight * each.change[each.inner]
        light = self._far.apply(drive)
        own = float(np.sum(self._maps.lit[..., None] * light**2))
        seen = (each.square.gathered(light.reshape(-1, 3)).reshape(each.change.shape) for each in changes)
        return own + 2 * sum(each.weight * each.along(picture) for each, picture in zip(changes, seen, strict=True))

    def _chances(self, promised: FloatArray) -> FloatArray:
        """Of each square in one lot: the same for all, or half of it in proportion to what a step would gain there."""
        alike, total = np.full(promised.size, 1 / promised.size), promised.sum()
        return alike if self._whole or not total > 0 else (alike + promised / total) / 2

    def _draw(self, chances: FloatArray) -> list[tuple[int, float]]:
        """Numbers of squares, and how many each stands for; drawn in steps of equal chance."""
        if self._whole:
            return [(number, 1.0) for number in range(chances.size)]
        count = max(MOST_ENTRIES * chances.size // self._entries, FEWEST)
        at = (np.arange(count) + self._lots.uniform()) / count
        drawn = np.minimum(np.searchsorted(np.cumsum(chances), at, side="right"), chances.size - 1)
        numbers, lots = np.unique(drawn, return_counts=True)
        return list(zip(numbers.tolist(), (lots / (count * chances[numbers])).tolist(), strict=True))

    def _solve(self, snapshot: Snapshot, slope: Picture, number: int, weight: float) -> tuple[_Change, _Change]:
        """A square to the end, and by as many steps again."""
        outer, inner = self._part(number)
        sought, judged = self._squares.get(number) or self._square(outer)
        if self._whole:
            self._squares[number] = sought, judged
        pictures = snapshot.drive, snapshot.ahead, slope, snapshot.unweighted
        p, y, s, d = (np.ascontiguousarray(picture[outer], np.float64) for picture in pictures)
        to_the_end = descend(judged, p, d, np.zeros_like(p), TO_THE_END, MOST_STEPS)[0]
        again = descend(sought, p, s, y - p, snapshot.made, max(snapshot.steps, 1))[0]
        best, further = (
            _Change(judged, outer, inner, weight, change, seen_change(judged, change)) for change in (to_the_end, again)
        )
        return best, further

    def _square(self, part: Part) -> tuple[Square, Square]:
        """Of what steps seek, and of the unweighted error."""
        sought = square_of(self._maps, part)
        return sought, unweighted(sought, self._maps.lit)

    def _part(self, number: int) -> tuple[Part, Part]:
        """A square with its halo, and where in that the square is."""
        outer, inner = [], []
        for at, length in zip(divmod(number, self._shape[1]), self._maps.dual.output_shape, strict=True):
            first, last = SIDE * at, min(SIDE * (at + 1), length)
            outer.append(slice(max(first - HALO, 0), min(last + HALO, length)))
            inner.append(slice(first - outer[-1].start, last - outer[-1].start))
        return (outer[0], outer[1]), (inner[0], inner[1])

    def _ratio_db(self, error: float, less: float) -> float:
        return float(10 * np.log10((error + self._floor) / (less + self._floor)))


def _promise(p: Picture, slope: Picture, step: Picture) -> FloatArray:
    """What one step would gain of the objective at least, pixel by pixel, all channels: (height, width)."""
    change = np.clip(p + step * slope, 0, 1) - p
    curved = np.divide(change**2, step, out=np.zeros_like(change), where=step > 0)
    return np.asarray(np.sum(slope * change * (step > 0) - curved / 2, axis=2, dtype=np.float64))


def _relative_error(changes: list[_Change], descent: Picture) -> float:
    """Standard error of what is gained, over it, by how the squares' shares of it differ."""
    shares = np.array([each.weight * each.along(2 * descent[each.outer] - each.lit) for each in changes])
    mean = shares.mean()
    return float(shares.std(ddof=1) / np.sqrt(shares.size) / mean) if shares.size > 1 and mean > 0 else 0.0

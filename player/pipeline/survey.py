"""Estimates how far a picture is below the unweighted optimum, by solving all its squares, or a sample, to the end.

A certificate (refinement.py) is only a bound, and far from the true value. The errors that steps leave have high
spatial frequency, because steps remove low frequencies first. A square is therefore solved alone: a halo around the
square changes with it, and everything beyond the halo stays (squares.py). Its gain equals the gain in the whole picture
to within a few percent. If the maps are too large for all squares, a random sample is drawn, with higher probability
where one step gains much. Gains are divided by these probabilities.

Far light couples all squares, but a single square ignores this coupling. The combined change δ is therefore applied to
far light at the end and scaled by the best common factor: α ≤ 1 gains 2 α dᵀδ − α² ‖T δ‖², T with far light. The error
is unweighted over the lit camera pixels, d = Tᵀ (b − T p). Refinement's objective drives the steps; this error judges
the result.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from counterlight.maps.prior import pull
from counterlight.passes.certificate import block_sum
from counterlight.pipeline.operators import prepared
from counterlight.pipeline.room import Room
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
SIDE, HALO = 32, 8  # side of a square and width of its halo, projector pixels
MOST_ENTRIES = 4_000_000  # entries of TᵀW that an estimate reads: a few seconds of one core
FEWEST = 12  # least number of squares in a sample
FAINTEST = 1e-6  # share of white²; an error 60 dB below white counts as none


@dataclass(frozen=True)
class _Change:
    """The change of a square, (height, width, 3).

    square : sum of the unweighted squared error.
    outer : the square with its halo, in the projector picture.
    inner : the square within `outer`.
    weight : number of squares that it represents.
    lit : TᵀT of the change with its halo, near light only.
    """

    square: Square
    outer: Part
    inner: Part
    weight: float
    change: FloatArray
    lit: FloatArray

    def along(self, picture: NDArray[np.floating]) -> float:
        """Return the inner product of the change with a picture of the outer part."""
        return float(np.sum((self.change * picture)[self.inner]))


class Survey:
    """Estimates for the pictures of one room with the maps of refinement."""

    def __init__(self, room: Room) -> None:
        assert room.maps.refinement is not None
        self._maps, self._far = room.maps.refinement, prepared(room.maps.far)
        self._lit = room.certified
        self._floor = FAINTEST * room.white**2 * 3 * int(self._lit.sum())
        entries = block_sum(self._maps.dual.lookup[..., 2].astype(np.int64), SIDE)
        self._shape, self._entries = entries.shape, int(entries.sum() * (1 + 2 * HALO / SIDE) ** 2)
        self._whole = self._entries <= MOST_ENTRIES
        self._squares: dict[int, tuple[Square, Square]] = {}  # cached if all squares are solved every time
        self._lots = np.random.default_rng(0)

    def of(self, snapshot: Snapshot) -> Shortfall:
        """Return the estimate. Takes a second or two of one core, mostly without Python's lock."""
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
        """Return the reduction of Σ (T p − b)² by all changes; `shortened` scales them by the best common factor."""
        along = sum(each.weight * each.along(descent[each.outer]) for each in changes)
        bent = sum(each.weight * each.along(each.lit) for each in changes) + self._bent_by_far_light(changes)
        share = min(max(along / bent, 0.0), 1.0) if shortened and bent > 0 else 1.0
        return float(2 * share * along - share**2 * bent)

    def _bent_by_far_light(self, changes: list[_Change]) -> float:
        """Return ‖T δ‖² minus the share of near light."""
        if self._far is None:
            return 0.0
        drive = np.zeros((*self._maps.dual.output_shape, 3))
        for each in changes:
            drive[each.outer][each.inner] = each.weight * each.change[each.inner]
        light = self._far.apply(drive)
        own = float(np.sum(self._lit[..., None] * light**2))
        seen = (each.square.gathered(light.reshape(-1, 3)).reshape(each.change.shape) for each in changes)
        return own + 2 * sum(each.weight * each.along(picture) for each, picture in zip(changes, seen, strict=True))

    def _chances(self, promised: FloatArray) -> FloatArray:
        """Return each square's probability per draw: uniform, or half uniform, half proportional to a step's gain."""
        alike, total = np.full(promised.size, 1 / promised.size), promised.sum()
        return alike if self._whole or not total > 0 else (alike + promised / total) / 2

    def _draw(self, chances: FloatArray) -> list[tuple[int, float]]:
        """Return the indices of sampled squares, and how many squares each represents, by systematic sampling."""
        if self._whole:
            return [(number, 1.0) for number in range(chances.size)]
        count = max(MOST_ENTRIES * chances.size // self._entries, FEWEST)
        at = (np.arange(count) + self._lots.uniform()) / count
        drawn = np.minimum(np.searchsorted(np.cumsum(chances), at, side="right"), chances.size - 1)
        numbers, lots = np.unique(drawn, return_counts=True)
        return list(zip(numbers.tolist(), (lots / (count * chances[numbers])).tolist(), strict=True))

    def _solve(self, snapshot: Snapshot, slope: Picture, number: int, weight: float) -> tuple[_Change, _Change]:
        """Solve a square to the end, and with as many further steps as the frame had."""
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
        """Return the square with the weights of the steps' objective, and the same square without weights."""
        sought = square_of(self._maps, part)
        return sought, unweighted(sought, self._lit)

    def _part(self, number: int) -> tuple[Part, Part]:
        """Return a square with its halo, and the position of the square within it."""
        outer, inner = [], []
        for at, length in zip(divmod(number, self._shape[1]), self._maps.dual.output_shape, strict=True):
            first, last = SIDE * at, min(SIDE * (at + 1), length)
            outer.append(slice(max(first - HALO, 0), min(last + HALO, length)))
            inner.append(slice(first - outer[-1].start, last - outer[-1].start))
        return (outer[0], outer[1]), (inner[0], inner[1])

    def _ratio_db(self, error: float, less: float) -> float:
        return float(10 * np.log10((error + self._floor) / (less + self._floor)))


def _promise(p: Picture, slope: Picture, step: Picture) -> FloatArray:
    """Return a lower bound of one step's gain in the objective per pixel, all channels: (height, width)."""
    change = np.clip(p + step * slope, 0, 1) - p
    curved = np.divide(change**2, step, out=np.zeros_like(change), where=step > 0)
    return np.asarray(np.sum(slope * change * (step > 0) - curved / 2, axis=2, dtype=np.float64))


def _relative_error(changes: list[_Change], descent: Picture) -> float:
    """Return the relative standard error of the total gain, from the variation between squares."""
    shares = np.array([each.weight * each.along(2 * descent[each.outer] - each.lit) for each in changes])
    mean = shares.mean()
    return float(shares.std(ddof=1) / np.sqrt(shares.size) / mean) if shares.size > 1 and mean > 0 else 0.0

"""Decide whether T is dense, and find the cheapest S + U M D whose pictures lose no more than a tolerance.

Grids are fitted from coarse to fine. For each grid, one pass over T gives the number of near entries and the loss of
pictures for every limit. The cheapest candidate is computed and measured; if it loses more than estimated, a stricter
candidate is tried. T stays unchanged if factors do not halve its size.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from counterlight import memory
from counterlight.arrays import FloatArray
from counterlight.errors import InputError
from counterlight.tools.blurring.blurring import Blurring, in_blocks
from counterlight.tools.choices import MOST_TOLERANCE, TOLERANCE
from counterlight.tools.factoring import passes
from counterlight.tools.factoring.losses import asked, compensated, each_picture, measured
from counterlight.tools.factoring.model import PEAK, Model, Rows, fitted, split
from counterlight.tools.transport.mask import directly_lit
from counterlight.tools.transport.transport import FarLight, Transport

WORTH = 0.5  # largest share of T's numbers that may remain; if more remain, T stays unfactored
GRIDS = ((48, 24), (108, 54), (192, 108), (432, 216), (768, 432))  # nodes of the camera and of the projector
MOST_FAR = 0.5  # share of all light; near light must be the larger part, because S⁺ and the mask depend on it
MOST_OF_A_ROW = 1 / 16  # share of its row's far light; an entry above this share is near light
LIMITS = np.array([1.0, 2, 4, 8, 16, 32, 64, 128, 256, 512, 1024, 2048, 4096])
# estimates of the loss to accept, relative to the tolerance; most estimates are too high
MARGINS = (2.0, 1.0, 0.5, 0.25, 0.12)
MOST_READ = 1 << 13  # pixels between a node and its neighbours: half of a texture's row (maps/row_map.py)
MOST_NODES = 1500  # a dense matrix mixes them
BYTES_A_ROW, BYTES_A_SUM = 600, 120  # per pixel of either side: five pictures' light and textures; a thread's five sums
BYTES_AN_ENTRY = 20  # bytes per entry: half of T's entries again with their model values, and two marks per entry


@dataclass(frozen=True)
class Factoring:
    """The factors of T; the text is a line of a command's output.

    before, after : numbers per channel: entries of near light and non-zero numbers of the factors.
    near : entries of near light.
    losses : dB of the camera picture by the names of pictures.
    reason : why T has no factors, or "".
    blurring : blocks of rows that were still too long; None if there were none.
    """

    before: int
    after: int
    near: int
    losses: dict[str, float] = field(default_factory=dict)
    reason: str = ""
    blurring: Blurring | None = None

    def __str__(self) -> str:
        far = f"no far light in factors: {self.reason}" if self.reason and self.blurring else self._of_far_light()
        return far if self.blurring is None else f"{far}; {self.blurring}"

    def _of_far_light(self) -> str:
        if self.reason:
            return f"T is left as it is, {self.before} numbers a channel: {self.reason}"
        lost = ", ".join(f"{name} {loss:.3f}" for name, loss in self.losses.items())
        return (
            f"dense T factored: {self.before} entries a channel are {self.near} of near light and "
            f"{self.after - self.near} numbers of far light; pictures lose, in dB: {lost}"
        )


def factored(
    transport: Transport, ambient: NDArray[np.floating], tolerance: float = TOLERANCE
) -> tuple[Transport, Factoring]:
    """Factor T into near light and factors if that is worthwhile; returns T or its factors, and a report.

    transport : T with its pictures' sizes.
    ambient : (camera height, camera width, 3).
    tolerance : dB that a compensated picture may lose; 0 keeps T unfactored.

    Raises InputError for a tolerance out of range, and if memory does not suffice.
    """
    if not 0 <= tolerance <= MOST_TOLERANCE:
        raise InputError(f"tolerance {tolerance:g}: expected 0 (T stays as it is) to {MOST_TOLERANCE:g} dB")
    before = numbers(transport)
    left = Factoring(before, before, transport.near.indices.size)
    if tolerance == 0:
        return transport, replace(left, reason="--tolerance 0")
    if transport.blurred is not None:
        return transport, replace(left, reason="its blurred light is in factors")
    if _least_numbers(transport) > WORTH * _entries(transport):
        return transport, replace(left, reason="it is sparse")
    if has_too_many_pixels(transport):
        return transport, replace(left, reason=f"more than {MOST_NODES * MOST_READ // 4} pixels are too many nodes")
    _check_memory(transport)
    rows = Rows.of(transport)
    if np.count_nonzero(rows.apart) > WORTH * before:
        return transport, replace(left, reason="its light is near light")
    return _Search(rows, ambient, tolerance).found(left)


def compacted(
    transport: Transport, ambient: NDArray[np.floating], tolerance: float = TOLERANCE
) -> tuple[Transport, Factoring]:
    """Like `factored`; then replaces rows that are still too long by blocks, within the rest of the tolerance."""
    made, done = factored(transport, ambient, tolerance)
    made, blurring = in_blocks(made, tolerance - max(done.losses.values(), default=0.0))
    return made, replace(done, blurring=blurring)


def numbers(transport: Transport) -> int:
    """Returns the numbers per channel of T: near entries, and non-zero numbers of D, M and U."""
    far = transport.far
    return int(transport.near.indices.size) + (0 if far is None else factor_numbers(far))


def _far_share(transport: Transport) -> float:
    """Returns the share of all light that is far."""
    whole = float(transport.composition().sum())
    return 1 - float(transport.near.sums().sum()) / whole if whole > 0 else 0.0


def factor_numbers(far: FarLight) -> int:
    """Returns the numbers per channel of D, M and U."""
    mixed = int(np.count_nonzero(far.mix.matrices.any(axis=0)))
    return int(far.gather.indices.size + far.scatter.indices.size) + mixed


def _entries(transport: Transport) -> int:
    """Returns how many numbers of T belong to a pixel; factors reduce only these."""
    far = transport.far
    known = 0 if far is None else far.gather.indices.size + far.scatter.indices.size
    return int(transport.near.indices.size + known)


def _least_numbers(transport: Transport) -> int:
    """Returns the least size of any factors, which place each pixel of either side between four nodes."""
    lit = int(np.count_nonzero(transport.near.lengths))
    return 4 * (lit + transport.shape[1])


@dataclass(frozen=True)
class _Candidate:
    cells: tuple[int, int]
    limit: float
    numbers: int
    losses: FloatArray


class _Search:
    """Searches the factors of T: lists candidates, then takes the cheapest that keeps the tolerance."""

    def __init__(self, rows: Rows, ambient: NDArray[np.floating], tolerance: float) -> None:
        self._rows, self._tolerance = rows, tolerance
        T = rows.transport
        self._most = int(WORTH * numbers(T))
        self._limits = LIMITS[max(T.shape[1] * MOST_OF_A_ROW, LIMITS[0]) >= LIMITS]
        assert T.projector is not None
        self._pictures = asked(T, directly_lit(T, ambient, T.projector))

    def found(self, left: Factoring) -> tuple[Transport, Factoring]:
        candidates, T = self._candidates(), self._rows.transport
        reason = f"no factors of half its size keep pictures within {self._tolerance:g} dB"
        for margin in MARGINS:
            fitting = self._fitting(candidates, margin)
            if not fitting:
                break
            chosen = min(fitting, key=lambda each: (each.numbers, abs(np.log(each.limit / PEAK))))
            # The fit treats all entries above the limit as near light. A limit below PEAK would fall in every round.
            model = fitted(self._rows, chosen.cells, max(chosen.limit, PEAK))
            made = split(self._rows, replace(model, limit=chosen.limit))
            if _far_share(made) > MOST_FAR:
                reason = "factors would hold most of its light, which is wide rather than far"
                continue
            losses = measured(T, made, self._pictures)
            if max(losses.values()) <= self._tolerance and numbers(made) <= self._most:
                return made, Factoring(left.before, numbers(made), made.near.indices.size, losses)
        return T, replace(left, reason=reason)

    def _candidates(self) -> list[_Candidate]:
        """Returns candidates of ever finer grids, as long as one can be cheaper; the first gives the drives."""
        errors, found, cheapest = None, list[_Candidate](), self._most
        for cells in grids_over(self._rows.transport):
            model = fitted(self._rows, cells, PEAK)
            far = factor_numbers(model.far_light())
            if far >= cheapest:
                break
            if errors is None:
                rough = split(self._rows, model)
                self._pictures = compensated(rough, self._pictures)
                errors = self._pictures.squared_error(rough)
            kept, squares = self._missed(model)
            losses = self._pictures.losses(squares, errors)
            found += [
                _Candidate(cells, limit, int(count) + far, loss)
                for limit, count, loss in zip(self._limits, kept, losses, strict=True)
            ]
            fitting = self._fitting(found, MARGINS[-1])
            cheapest = min((each.numbers for each in fitting), default=self._most)
        return found

    def _fitting(self, candidates: list[_Candidate], margin: float) -> list[_Candidate]:
        """Returns the candidates that are small enough and lose at most this share of the tolerance."""
        return [
            each for each in candidates if each.numbers <= self._most and each.losses.max() <= margin * self._tolerance
        ]

    def _missed(self, model: Model) -> tuple[NDArray[np.int64], FloatArray]:
        """Returns the near entries per limit, (limits,), and Σ δ², (limits, 3, pictures)."""
        rows, pictures = self._rows, self._pictures
        drive = np.concatenate([np.ones((rows.near.shape[1], 3, 1)), pictures.drive], axis=2)
        far = rows.transport.far
        known = np.zeros((rows.near.shape[0], 3, drive.shape[2])) if far is None else each_picture(far.apply, drive)
        entries = passes.operands(rows.near)
        kept, squares = passes.missed(
            *entries, rows.relative, self._limits, *model.textures, *model.grids, drive, known, pictures.counted
        )
        return kept.sum(axis=0), squares[..., 1:].sum(axis=0)


def has_too_many_pixels(transport: Transport) -> bool:
    """Whether there are too many pixels for nodes with at most MOST_READ pixels in between."""
    return max(transport.shape) > MOST_NODES * MOST_READ // 4


def grids_over(transport: Transport) -> list[tuple[int, int]]:
    """Returns numbers of nodes of the camera and the projector, fine enough for the rows of maps, the finest last."""
    least = max(transport.shape) // (MOST_READ // 4)
    return sorted({(max(camera, least), max(projector, least)) for camera, projector in GRIDS})


def _check_memory(transport: Transport) -> None:
    rows, columns = transport.shape
    parts = passes.PARTS[columns > passes.WIDE]
    needed = BYTES_A_ROW * rows + (BYTES_A_ROW + BYTES_A_SUM * parts) * columns
    needed += BYTES_AN_ENTRY * transport.near.indices.size
    memory.check(needed, "factoring a dense T", "close other programs, or keep T as it is with --tolerance 0")

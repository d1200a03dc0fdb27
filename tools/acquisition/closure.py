"""Check that the captures of a level add up to the floodlit room, decoding each capture only once."""

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray
from counterlight.errors import InputError
from counterlight.tools.acquisition.plan import Captures, Level, Reference

CLEARLY_LIT = 10  # light of a clearly lit pixel, in multiples of the noise of all captures together
MOST_UNCLOSED = 0.02  # largest share of the clearly lit camera pixels whose sum may be off by more than UNCLOSED
# allowed error of a sum, relative to the floodlight: for blocks, and for codes (half of the room lit)
UNCLOSED, UNCLOSED_CODE = 0.5, 0.35


class SummedCaptures:
    """The captures of a level, summed as a scheme reads them."""

    def __init__(self, captures: Captures) -> None:
        self._captures, self._missing = captures, set(range(len(captures)))
        self._total: FloatArray | None = None

    @property
    def repeats(self) -> int:
        return self._captures.repeats

    def __len__(self) -> int:
        return len(self._captures)

    def __getitem__(self, index: int) -> NDArray[np.floating]:
        capture = self._captures[index]
        if index in self._missing:
            self._missing.remove(index)
            self._total = (
                capture.astype(np.float64) if self._total is None else np.add(self._total, capture, out=self._total)
            )
        return capture

    def above_black(self, room: Reference) -> FloatArray:
        """Returns the sum of all captures above black, (camera pixels, 3)."""
        for index in sorted(self._missing):
            self[index]
        total = np.zeros_like(room.black) if self._total is None else self._total
        return np.asarray(total - len(self) * room.black).reshape(-1, 3)


def check_closure(level: Level, captures: SummedCaptures, room: Reference) -> None:
    """Raises InputError if the captures of a level do not add up to `level.cover` floodlit rooms.

    A mismatch means that some capture shows another pattern, is black, or was taken with another exposure.
    """
    if not level.cover:
        return
    total, light = captures.above_black(room), room.light
    # Each capture contains the error of the black picture, so the noise grows with the number of captures, not with
    # its square root.
    lit = np.any(light > CLEARLY_LIT * room.noise.dark * len(captures), axis=1) & ~room.saturated.ravel()
    if not lit.any():
        return
    rooms = total[lit].sum(axis=1) / light[lit].sum(axis=1)
    expected = np.median(rooms)  # about level.cover: a lamp drifts a little
    most = UNCLOSED if level.cover == 1 else UNCLOSED_CODE
    off = (np.abs(rooms - expected) > most) | (abs(expected - level.cover) > UNCLOSED * level.cover)
    if off.mean() > MOST_UNCLOSED:
        raise InputError(
            f"{level.name}: its captures do not add up to the floodlit room in {100 * off.mean():.0f} % of the lit "
            "camera pixels; one of them shows another pattern or is black, or light or exposure changed: remove the "
            "captures of this level and run again"
        )

"""T put together band by band of camera rows: many rays become few entries, and memory holds entries only."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray, IntArray
from counterlight.errors import InputError
from counterlight.maps.row_map import SparseRows

MAX_BYTES = 6 << 30
BYTES_AN_ENTRY = 4 + 3 * 4
SHORTER = 0.5  # than the rows so far the others may be
ADVICE = "lower samples or the devices' sizes, or raise threshold"


@dataclass
class NearLight:
    """Collects T's entries; the three channels share one pattern.

    shape : (camera pixels, projector pixels).  threshold : entries below this share of their row's largest are left out
    where they are that small in every channel; what stays is scaled so that each row keeps its sum.
    """

    shape: tuple[int, int]
    threshold: float
    name: str
    _lengths: list[IntArray] = field(default_factory=list)
    _columns: list[NDArray[np.int32]] = field(default_factory=list)
    _weights: list[NDArray[np.float32]] = field(default_factory=list)

    def add_band(self, first: int, rows: int, pixel: IntArray, column: IntArray, weights: FloatArray) -> None:
        """Entries (n,), (n,), (n, 3) of camera pixels first … first + rows − 1; duplicates are summed."""
        place, weights = summed((pixel - first) * self.shape[1] + column, weights)
        row = place // self.shape[1]
        if self.threshold:
            keep, factor = thinned(row, rows, weights, self.threshold)
            place, row, weights = place[keep], row[keep], weights[keep] * factor[row[keep]]
        self._lengths.append(np.bincount(row, minlength=rows))
        self._columns.append((place % self.shape[1]).astype(np.int32))
        self._weights.append(weights.astype(np.float32))
        self._refuse_what_cannot_fit((first + rows) / self.shape[0])

    def _refuse_what_cannot_fit(self, done: float) -> None:
        """InputError once T would be too large even if its other rows were half as long.  done : share of them."""
        held = sum(column.size for column in self._columns) * BYTES_AN_ENTRY
        if held * (1 + SHORTER * (1 / done - 1)) > MAX_BYTES:
            raise InputError(
                f"{self.name}: T would take about {held / done / 2**30:.0f} GiB ({100 * done:.0f} % of its rows take "
                f"{held / 2**30:.2f}), at most {MAX_BYTES >> 30} are used; {ADVICE}"
            )

    def rows(self) -> SparseRows:
        """T, float32."""
        starts = np.concatenate([[0], np.cumsum(np.concatenate(self._lengths))])
        return SparseRows(starts, np.concatenate(self._columns), np.concatenate(self._weights), self.shape[1])


def summed(places: IntArray, weights: FloatArray) -> tuple[IntArray, FloatArray]:
    """Sorted distinct places and the sums (n, 3) of their weights."""
    if not places.size:
        return places.astype(np.int64), np.zeros((0, 3))
    order = np.argsort(places, kind="stable")
    places = places[order]
    first = np.concatenate([[0], np.flatnonzero(np.diff(places)) + 1])
    return places[first], np.add.reduceat(weights[order], first, axis=0)


def thinned(row: IntArray, rows: int, weights: FloatArray, threshold: float) -> tuple[NDArray[np.bool_], FloatArray]:
    """Which entries stay, and what each row and channel of them is to be scaled by."""
    largest, before, after = (np.zeros((rows, 3)) for _ in range(3))
    np.maximum.at(largest, row, weights)
    keep = np.any(weights > threshold * largest[row], axis=1)
    for i in range(3):
        before[:, i] = np.bincount(row, weights[:, i], rows)
        after[:, i] = np.bincount(row[keep], weights[keep, i], rows)
    return keep, np.divide(before, after, out=np.ones((rows, 3)), where=after > 0)

"""T, assembled in bands of camera rows. Many rays become few entries, and only the entries stay in memory."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray, IntArray
from counterlight.errors import InputError
from counterlight.maps.row_map import SparseRows, below_each_other
from counterlight.tools.blurring.blurring import Blurring, Choice, chosen_limit, too_long
from counterlight.tools.blurring.pruning import Pyramid, in_cells
from counterlight.tools.transport.transport import BlurredLight

MAX_BYTES = 6 << 30
BYTES_AN_ENTRY = 4 + 3 * 4
SHORTER = 0.5  # assumed length of the remaining rows, as a share of the rows so far
ADVICE = "lower samples or the devices' sizes, or raise threshold"


@dataclass(frozen=True)
class Blur:
    """Parameters for shortening long rows: blocks of projector pixels replace single entries.

    raster : (height, width) of the projector.
    width : width of the camera picture in pixels.
    tolerance : dB, as `chosen_limit`.
    """

    raster: tuple[int, int]
    width: int
    tolerance: float


@dataclass
class NearLight:
    """Collects T's entries; the three channels share one pattern.

    shape : (camera pixels, projector pixels).
    threshold : fraction of the row's largest entry. An entry below it in every channel is dropped; the remaining
        entries are scaled so that each row keeps its sum.
    blur : how to shorten rows that are too long for maps; None keeps them.
    """

    shape: tuple[int, int]
    threshold: float
    name: str
    blur: Blur | None = None
    _near: list[SparseRows] = field(default_factory=list)
    _blurred: list[SparseRows] = field(default_factory=list)
    _before: int = 0
    _choice: Choice | None = None

    def add_band(self, first: int, rows: int, pixel: IntArray, column: IntArray, weights: FloatArray) -> None:
        """Add the entries of camera pixels first … first + rows − 1; duplicates are summed.

        Bands come in order. With `blur`, a band holds whole lines of the camera picture.

        pixel, column : (n,).
        weights : (n, 3).
        """
        self.add(self.band(first, rows, pixel, column, weights), (first + rows) / self.shape[0])

    def add(self, band: SparseRows, done: float) -> None:
        """Add a band that `band` made.

        done : share of T's rows that are present after this band.
        """
        self._hold(band)
        self._refuse_what_cannot_fit(done)

    def band(self, first: int, rows: int, pixel: IntArray, column: IntArray, weights: FloatArray) -> SparseRows:
        """Returns the entries of one band as rows; independent of all other bands."""
        place, weights = summed((pixel - first) * self.shape[1] + column, weights)
        row = place // self.shape[1]
        if self.threshold:
            keep, factor = thinned(row, rows, weights, self.threshold)
            place, row, weights = place[keep], row[keep], weights[keep] * factor[row[keep]]
        starts = np.concatenate([[0], np.cumsum(np.bincount(row, minlength=rows))])
        columns = (place % self.shape[1]).astype(np.int32)
        return SparseRows(starts, columns, weights.astype(np.float32), self.shape[1])

    def _hold(self, band: SparseRows) -> None:
        self._before += band.indices.size
        self._near.append(band)
        if self._choice is not None:
            self._put_in_cells(len(self._near) - 1)
        elif self.blur is not None and too_long(self._before, self.shape[0]):
            self._choice = chosen_limit(self._near, self.blur.width, self.blur.raster, self.blur.tolerance)
            for number in range(len(self._near)):
                self._put_in_cells(number)

    def _put_in_cells(self, number: int) -> None:
        if self.blur is None or self._choice is None or not self._choice.limit:
            return
        near, blurred = in_cells(self._near[number], self.blur.raster, self._choice.limit)
        self._near[number] = near
        self._blurred.append(blurred)

    def _refuse_what_cannot_fit(self, done: float) -> None:
        """Raises InputError if T would be too large even with the remaining rows half as long.

        done : share of T's rows that are present.
        """
        held = sum(band.indices.size for band in (*self._near, *self._blurred)) * BYTES_AN_ENTRY
        if held * (1 + SHORTER * (1 / done - 1)) > MAX_BYTES:
            raise InputError(
                f"{self.name}: T would take about {held / done / 2**30:.0f} GiB ({100 * done:.0f} % of its rows take "
                f"{held / 2**30:.2f}), at most {MAX_BYTES >> 30} are used; {ADVICE}{self._more_advice()}"
            )

    def _more_advice(self) -> str:
        return ", or raise --tolerance" if self.blur is not None else ""

    def rows(self) -> SparseRows:
        """S, float32; all of T if no light is in cells."""
        return below_each_other(self._near)

    def blurred(self) -> BlurredLight | None:
        """B P, or None if no light is in cells."""
        if self.blur is None or not self._blurred:
            return None
        return Pyramid(self.blur.raster).light(below_each_other(self._blurred))

    def blurring(self) -> Blurring | None:
        """Returns a report on the shortening of long rows, or None if no row was shortened."""
        if not self._blurred or self._choice is None:
            return None
        near, blurred = (sum(band.indices.size for band in bands) for bands in (self._near, self._blurred))
        return Blurring(self._before, near, blurred, self._choice.losses)


def summed(places: IntArray, weights: FloatArray) -> tuple[IntArray, FloatArray]:
    """Returns the sorted distinct places and the sums (n, 3) of their weights."""
    if not places.size:
        return places.astype(np.int64), np.zeros((0, 3))
    order = np.argsort(places, kind="stable")
    places = places[order]
    first = np.concatenate([[0], np.flatnonzero(np.diff(places)) + 1])
    return places[first], np.add.reduceat(weights[order], first, axis=0)


def thinned(row: IntArray, rows: int, weights: FloatArray, threshold: float) -> tuple[NDArray[np.bool_], FloatArray]:
    """Returns the mask of the entries that stay, and the scale factor (rows, 3) that keeps each row's sum."""
    largest, before, after = (np.zeros((rows, 3)) for _ in range(3))
    np.maximum.at(largest, row, weights)
    keep = np.any(weights > threshold * largest[row], axis=1)
    for i in range(3):
        before[:, i] = np.bincount(row, weights[:, i], rows)
        after[:, i] = np.bincount(row[keep], weights[keep, i], rows)
    return keep, np.divide(before, after, out=np.ones((rows, 3)), where=after > 0)

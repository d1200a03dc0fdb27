"""Choose how much rows of T may err such that pictures lose at most a tolerance, in decibels of the camera picture.

The loss is measured on the square of the camera picture with the longest rows. The player's steps compute drives for
three pictures, by T itself and by T in cells, and T itself judges both. The soft picture decides: through blur, the
other pictures arrive badly with any T. A film comes close to its target and loses up to four times as much. Sampling
the same room differently causes most of that loss, too (docs/size.md).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import BoolArray, FloatArray, IntArray
from counterlight.maps.row_map import SparseRows, below_each_other
from counterlight.tools.blurring.pruning import COARSEST, Pyramid, in_cells
from counterlight.tools.inverse.pictures import soft_picture, typical_pictures
from counterlight.tools.transport.objective import Objective
from counterlight.tools.transport.transport import Transport

LIMITS = 0.032 * np.sqrt(0.5) ** np.arange(16)  # limits to try: down to 1.8e-4
SIDE = 128  # camera pixels of the square: several times the widest blur, so that its border does not matter
MOST_ENTRIES = 1 << 25  # entries of T in the square
NAMES = ("photograph", "letters", "soft")
STEPS = 64  # steps that are taken as the optimum
DARKEST = 1e-6  # mean error, relative to white², that counts as zero: 60 dB below white
BRIGHT = 10  # percentile of the floodlit pixels that is taken as white, as in `reachable_white`


@dataclass(frozen=True)
class Choice:
    """A chosen limit.

    limit : as `in_cells` takes it; 0 if no limit keeps the tolerance.
    losses : dB by the names of pictures.
    """

    limit: float
    losses: dict[str, float] = field(default_factory=dict)


def chosen_limit(bands: Sequence[SparseRows], width: int, raster: tuple[int, int], tolerance: float) -> Choice:
    """Returns the largest of LIMITS with which pictures lose at most `tolerance` dB.

    bands : consecutive rows of T, in whole lines of the camera picture.
    width : camera pixels per line.
    raster : (height, width) of the projector.
    """
    square = _Square.of(bands, width, raster)
    low, high, found = 0, len(LIMITS), Choice(0.0)
    while low < high:
        middle = (low + high) // 2
        losses = square.losses(float(LIMITS[middle]))
        if max(losses) <= tolerance:
            high, found = middle, Choice(float(LIMITS[middle]), dict(zip(NAMES, losses, strict=True)))
        else:
            low = middle + 1
    return found


def judging_pictures(side: tuple[int, int]) -> list[FloatArray]:
    """Returns the pictures of NAMES, (height, width), linear, 0 to 1."""
    return [*typical_pictures(side)[:2], soft_picture(side)]


class _Square:
    """Some camera pixels, the projector pixels that light them, and the target pictures.

    rows : T of the camera pixels.
    columns : projector pixels, ascending.
    side : (height, width) of the square.
    """

    def __init__(self, rows: SparseRows, raster: tuple[int, int], columns: IntArray, side: tuple[int, int]) -> None:
        self._rows, self._raster, self._columns = rows, raster, columns
        self._T = self._objective(Transport(rows))
        floodlight = self._T.T.composition()
        self._white = float(np.percentile(floodlight[floodlight.any(axis=1)], BRIGHT))
        pictures = (picture.reshape(-1, 1) for picture in judging_pictures(side))
        self._asked = [np.repeat(self._white * picture, 3, axis=1) for picture in pictures]
        self._inner = _inner(side)
        self._errors = [self._error(self._T, b) for b in self._asked]

    @classmethod
    def of(cls, bands: Sequence[SparseRows], width: int, raster: tuple[int, int]) -> "_Square":
        lengths = np.concatenate([band.lengths for band in bands]).reshape(-1, width)
        side = int(min(SIDE, np.sqrt(MOST_ENTRIES / max(lengths.max(), 1))))
        down, across = (min(side, extent) for extent in lengths.shape)
        sums = np.pad(lengths.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
        inside = sums[down:, across:] - sums[:-down, across:] - sums[down:, :-across] + sums[:-down, :-across]
        top, left = np.unravel_index(inside.argmax(), inside.shape)
        chosen = ((top + np.arange(down))[:, None] * width + left + np.arange(across)).ravel()
        ends = np.cumsum([0, *(band.shape[0] for band in bands)])
        parts = np.split(chosen, np.searchsorted(chosen, ends[1:-1]))
        pairs = zip(bands, parts, ends[:-1], strict=True)
        within = below_each_other([band.at(part - first) for band, part, first in pairs])
        return cls(within, raster, _about(within.indices, raster), (down, across))

    def losses(self, limit: float) -> list[float]:
        """Returns the loss of each picture, dB."""
        near, scatter = in_cells(self._rows, self._raster, limit)
        made = self._objective(Transport(near, blurred=Pyramid(self._raster).light(scatter)))
        pairs = zip(self._asked, self._errors, strict=True)
        return [max(10 * float(np.log10(self._error(made, b) / least)), 0.0) for b, least in pairs]

    def _objective(self, T: Transport) -> Objective:
        return Objective.plain(T.of_columns(self._columns))

    def _error(self, by: Objective, b: FloatArray) -> float:
        """Returns the mean of (T p − b)² over the inner pixels, where p is the best drive by another T."""
        grey = np.full((self._columns.size, 3), 0.5)
        drive = next(islice(by.steps(grey, b), STEPS, None))
        wrong = (self._T.T.apply(drive) - b)[self._inner] / self._white
        return float(np.mean(wrong**2)) + DARKEST


def _about(indices: NDArray[np.integer], raster: tuple[int, int]) -> IntArray:
    """Returns all pixels of the coarsest blocks in the smallest rectangle around some pixels."""
    y, x = np.divmod(indices.astype(np.int64), raster[1])
    lines = [
        np.arange(each.min() // COARSEST * COARSEST, min((each.max() // COARSEST + 1) * COARSEST, extent))
        for each, extent in ((y, raster[0]), (x, raster[1]))
    ]
    return np.asarray((lines[0][:, None] * raster[1] + lines[1]).ravel())


def _inner(side: tuple[int, int]) -> BoolArray:
    """Returns the pixels without an eighth at each border, because there is no target beyond the border."""
    inner = np.zeros(side, bool)
    inner[side[0] // 8 : side[0] - side[0] // 8, side[1] // 8 : side[1] - side[1] // 8] = True
    return inner.ravel()

"""Decide whether rows of T are too long for maps, and replace them by blocks of pixels.

The limit of their errors is chosen such that pictures lose at most a tolerance, in decibels of the camera picture. The
loss is measured on the square of the camera picture with the longest rows. The player's steps compute drives for three
pictures, by T itself and by T in cells, and T itself judges both. The soft picture decides: through blur, the other
pictures arrive badly with any T. A film comes close to its target and loses up to four times as much. Sampling the same
room differently causes most of that loss, too (docs/size.md).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from counterlight import memory
from counterlight.arrays import BoolArray, FloatArray, IntArray
from counterlight.maps.row_map import SparseRows, below_each_other
from counterlight.tools.blurring.pruning import COARSEST, Pyramid, in_cells
from counterlight.tools.inverse.pictures import soft_picture, typical_pictures
from counterlight.tools.transport.objective import Objective
from counterlight.tools.transport.transport import Transport

LONG, MANY = 64, 1 << 24  # entries per camera pixel, and in total; a T with fewer of either is played unchanged
BAND = 1 << 22  # entries that are put into cells at a time
BYTES_AN_ENTRY = 16  # bytes per entry of a second T, whose bands are kept until the last band is done
LEAST_SAVED = 0.5  # largest share of T's entries that may remain; if more remain, T stays unchanged
LIMITS = 0.032 * np.sqrt(0.5) ** np.arange(16)  # limits to try, from 0.032 down to 1.8e-4
SIDE = 128  # camera pixels of the square: several times the widest blur, so that its border does not matter
MOST_ENTRIES = 1 << 25  # entries of T in the square
NAMES = ("photograph", "letters", "soft")
STEPS = 64  # number of steps whose result counts as the optimum
DARKEST = 1e-6  # mean error, relative to white², that counts as zero: it is 60 dB below white
BRIGHT = 10  # percentile of the floodlit pixels that is taken as white, as in `reachable_white`


@dataclass(frozen=True)
class Blurring:
    """The result of blurring.

    before : entries per channel at first.
    near, blurred : near and blurred entries per channel now.
    losses : dB by the names of pictures.
    """

    before: int
    near: int
    blurred: int
    losses: dict[str, float]

    def __str__(self) -> str:
        lost = ", ".join(f"{name} {loss:.3f}" for name, loss in self.losses.items())
        return (
            f"blurred light in blocks of pixels: {self.before} entries a channel are {self.near} near and "
            f"{self.blurred} blurred ones; where blur is widest pictures lose, in dB: {lost}"
        )


def too_long(entries: int, rows: int) -> bool:
    """Whether so many entries in so many rows are too many for maps."""
    return entries > max(LONG * rows, MANY)


def in_blocks(transport: Transport, tolerance: float) -> tuple[Transport, Blurring | None]:
    """Replace rows that are too long: S + U M D → S + B P + U M D; returns T unchanged and None if not worthwhile.

    transport : T with its pictures' sizes.
    tolerance : dB that a compensated picture may lose. Far light is ignored, which never underestimates the loss.

    Raises InputError if memory does not suffice.
    """
    near, camera, raster = transport.near, transport.camera, transport.projector
    assert camera is not None
    assert raster is not None
    if tolerance <= 0 or transport.blurred is not None or not too_long(near.indices.size, near.shape[0]):
        return transport, None
    needed = BYTES_AN_ENTRY * near.indices.size
    memory.check(needed, "putting blurred light into blocks", "close other programs, or keep T with --tolerance 0")
    choice = chosen_limit([near], camera[1], raster, tolerance)
    if not choice.limit:
        return transport, None
    parts = [in_cells(band, raster, choice.limit) for band in _bands(near)]
    sharp, scatter = (below_each_other(list(each)) for each in zip(*parts, strict=True))
    if sharp.indices.size + scatter.indices.size > LEAST_SAVED * near.indices.size:
        return transport, None
    done = Blurring(near.indices.size, sharp.indices.size, scatter.indices.size, choice.losses)
    return replace(transport, near=sharp, blurred=Pyramid(raster).light(scatter)), done


def _bands(rows: SparseRows) -> Iterator[SparseRows]:
    """Yield consecutive rows with about BAND entries at a time."""
    count = rows.shape[0]
    starts = np.unique(np.searchsorted(rows.indptr, np.arange(0, rows.indices.size, BAND)).clip(0, count))
    for first, end in zip(starts, [*starts[1:], count], strict=True):
        yield rows.at(np.arange(first, end))


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
    """Returns which pixels are inside, without an eighth at each border, because the target ends at the border."""
    inner = np.zeros(side, bool)
    inner[side[0] // 8 : side[0] - side[0] // 8, side[1] // 8 : side[1] - side[1] // 8] = True
    return inner.ravel()

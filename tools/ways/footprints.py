"""Shape of T's rows: the places in a projector's picture that light each camera pixel.

The *main footprint* of a row lies around its middle and is found from its brightest entry. It is straight light; the
size of both pixels, the blur of the lenses and scattering below the surface determine its width. Glass and mirrors add
further bright spots. Bounced light is spread over everything, and faint.
"""

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import BoolArray, FloatArray, IntArray
from counterlight.maps.row_map import SparseRows
from counterlight.raster import Region
from counterlight.tools.transport.overlap import batches, lengths_of
from counterlight.tools.transport.transport import Transport, in_one, luminance

FAINT = 0.02  # share of a row's brightest entry; fainter entries do not count for its width
# A normal spot ends at REACH times the radius that holds half of the light, plus BESIDE projector pixels.
REACH, BESIDE = 3.0, 1.5
BRIGHT = 0.1  # share of a row's brightest entry: a spot, not spread light
ROUNDS = 2  # refinements of the middle from the entries around it
PERIODS = (4, 8, 16, 32, 64)  # projector pixels, of stripes whose contrast is measured


@dataclass(frozen=True)
class Footprints:
    """Rows of T in one projector's part of the raster, (camera pixels, …). Light is luminance of T·1.

    light : all light.
    main : light in the main footprint.
    second : light in bright spots outside the main footprint.
    strewn : (…, 3), radiance. Light outside all spots.
    middle, second_middle : (…, 2), y and x in the projector's picture, pixels.
    spread : (…, 3). Mean squared distance from the middle per channel, pixels².
    count : number of equal entries that would make the main footprint, (Σw)² / Σw²; low if it consists of single spots.
    strewn_count : the same for strewn light.
    tails : mean fourth power of that distance over the square of the mean square; 2 for a normal spot, 4/3 for a disc.
    contrast : (…, PERIODS). Remaining contrast of stripes, in the worse of both directions.
    """

    light: FloatArray
    main: FloatArray
    second: FloatArray
    strewn: FloatArray
    middle: FloatArray
    second_middle: FloatArray
    spread: FloatArray
    count: FloatArray
    strewn_count: FloatArray
    tails: FloatArray
    contrast: FloatArray


def footprints(T: Transport, camera_pixels: IntArray, width: int, region: Region) -> Footprints:
    """Measure rows of T without far light.

    camera_pixels : (n,). Rows to measure.
    width : width of the raster that T's columns cover.
    region : the projector's part of the raster.
    """
    found = []
    near = T.without_far
    for some in batches(np.arange(camera_pixels.size), lengths_of(near)[camera_pixels]):
        rows = in_one(near.at(camera_pixels[some]))
        y, x = np.divmod(rows.indices.astype(np.int64), width)
        inside = (x >= region.left) & (x < region.left + region.width)
        inside &= (y >= region.top) & (y < region.top + region.height)
        place = np.stack([y - region.top, x - region.left], axis=1)[inside] + 0.5
        found.append(_Rows(rows.where(inside), place).measured())
    return Footprints(*(np.concatenate([getattr(each, f.name) for each in found]) for f in fields(Footprints)))


class _Rows:
    """Some rows of T, entry by entry."""

    def __init__(self, rows: SparseRows, place: FloatArray) -> None:
        self._rows, self._count, self._place = rows.rows, rows.shape[0], place
        self._weights = rows.weights.astype(np.float64)
        self._light = luminance(self._weights)
        brightest = np.zeros(self._count)
        np.maximum.at(brightest, self._rows, self._light)
        # each entry's light as a share of the row's brightest entry
        self._share = self._light / np.maximum(brightest, np.finfo(float).tiny)[self._rows]

    def measured(self) -> Footprints:
        middle, main = self._main()
        second, spot = ~main & (self._share >= BRIGHT), main & (self._share >= FAINT)
        away = ((self._place - middle[self._rows]) ** 2).sum(axis=1)
        squared = self._mean(away, self._light * spot)
        fourth = self._mean(away**2, self._light * spot)
        return Footprints(
            light=self._sum(self._light),
            main=self._sum(self._light * main),
            second=self._sum(self._light * second),
            strewn=np.stack([self._sum(weights * ~(main | second)) for weights in self._weights.T], axis=1),
            middle=middle,
            second_middle=self._centre(self._light * second),
            spread=np.stack([self._mean(away, weights * spot) for weights in self._weights.T], axis=1),
            count=self._alike(self._light * spot),
            strewn_count=self._alike(self._light * ~(main | second)),
            tails=np.divide(fourth, squared**2, out=np.zeros_like(fourth), where=squared > 0),
            contrast=self._contrasts(),
        )

    def _main(self) -> tuple[FloatArray, BoolArray]:
        """Returns the middles of the main footprints, and the mask of the entries in them."""
        middle = np.zeros((self._count, 2))
        spots = np.flatnonzero(self._share == 1)
        lit, first = np.unique(self._rows[spots], return_index=True)
        middle[lit] = self._place[spots[first]]
        main = np.ones(self._rows.size, bool)
        for _ in range(ROUNDS):
            main = self._around(middle)
            middle = self._centre(self._light * main)
        return middle, main

    def _around(self, middle: FloatArray) -> BoolArray:
        away = np.sqrt(((self._place - middle[self._rows]) ** 2).sum(axis=1))
        return np.asarray(away <= REACH * self._holding_half(away)[self._rows] + BESIDE)

    def _holding_half(self, away: FloatArray) -> FloatArray:
        """Returns the distance (rows,) that contains half of each row's light, without faint entries."""
        wide = np.flatnonzero(self._share >= FAINT)
        order = wide[np.lexsort((away[wide], self._rows[wide]))]
        rows, summed = self._rows[order], np.cumsum(self._light[order])
        total = np.bincount(rows, self._light[order], self._count)
        before = np.concatenate([[0.0], np.cumsum(total)[:-1]])
        behind = np.flatnonzero(summed - before[rows] >= 0.5 * total[rows] * (1 - 1e-9))
        found, first = np.unique(rows[behind], return_index=True)
        half = np.zeros(self._count)
        half[found] = away[order[behind[first]]]
        return half

    def _alike(self, light: FloatArray) -> FloatArray:
        squares = self._sum(light**2)
        return np.divide(self._sum(light) ** 2, squares, out=np.zeros_like(squares), where=squares > 0)

    def _contrasts(self) -> FloatArray:
        total, found = self._sum(self._light), list[FloatArray]()
        for period in PERIODS:
            phases = 2 * np.pi * self._place / period
            waves = [np.hypot(self._sum(self._light * np.cos(p)), self._sum(self._light * np.sin(p))) for p in phases.T]
            found.append(np.divide(np.minimum(*waves), total, out=np.zeros_like(total), where=total > 0))
        return np.stack(found, axis=1)

    def _centre(self, light: FloatArray) -> FloatArray:
        return np.stack([self._mean(along, light) for along in self._place.T], axis=1)

    def _mean(self, values: FloatArray, light: NDArray[np.floating]) -> FloatArray:
        total = self._sum(light)
        return np.divide(self._sum(values * light), total, out=np.zeros_like(total), where=total > 0)

    def _sum(self, values: NDArray[np.floating]) -> FloatArray:
        return np.bincount(self._rows, values, self._count).astype(np.float64, copy=False)

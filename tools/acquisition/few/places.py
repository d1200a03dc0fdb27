"""Find the place and the width of the spot that each camera pixel sees: ramps select the period, sines do the rest."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.special import erf

from counterlight.arrays import BoolArray, FloatArray, IntArray
from counterlight.tools.acquisition.few.order import DARKEST, FIRST_SINE, PERIOD, RAMPS
from counterlight.tools.acquisition.few.seen import Seen, Table

RAMP_SPREAD, PHASE_SPREAD = 7, 3  # sides of the median filters of rough places, in camera pixels
WIDTH_SPREAD = 3.0  # σ in camera pixels over which contrasts are averaged; neighbours see similar spots
LEAST_CONTRAST = 0.1  # contrast of a sine below which a camera pixel has no place
CLEAR = 4.0  # least contrast, in multiples of its noise
LEAST_DIRECT = 0.3  # share of the neighbours' contrast; a pixel with less contrast sees almost only far light
STRETCHES = np.linspace(0, 0.6, 13)  # shares of far light to try; far light flattens ramps
NARROWEST, WIDEST = 0.02, 0.9999  # limits of the contrasts from which widths are computed
MENDED = 2  # corrections of a phase for the spot's width and the response
STEPS = 3  # steps of Newton's method for rough places
REACH = 8  # projector pixels around a place that can share its light


@dataclass(frozen=True)
class Spots:
    """The spots that camera pixels see.

    place : (camera pixels, 2). Row and column, where projector pixels have integer middles.
    contrast : (camera pixels, 2). Contrast of a sine of PERIOD pixels, without the loss by the pixels' own width.
    seen : (camera pixels,) bool. Whether the pixel has a place.
    """

    place: FloatArray
    contrast: FloatArray
    seen: BoolArray

    def widths(self, far: FloatArray) -> FloatArray:
        """Returns σ of the Gaussians along rows and columns, (camera pixels, 2), for a share `far` of far light."""
        return width_of(self.contrast / (1 - far)[:, None], PERIOD)


def located(seen: Seen, table: Table) -> Spots:
    """Find the spots; `table` is the projector's light per code value."""
    sines = [_sines(seen, table, axis) for axis in range(2)]
    direct = seen.lit & np.all([each[-1].whole for each in sines], axis=0)
    rough = _rough(seen, table, [each[0] for each in sines], direct)
    place, contrast = np.zeros_like(rough), np.zeros_like(rough)
    for axis in range(2):
        found = rough[:, axis]
        for sine in sines[axis]:
            found = _median(sine.nearest(found), direct, seen.camera, PHASE_SPREAD)
        place[:, axis], contrast[:, axis] = sines[axis][-1].mended(sines[axis][-1].nearest(found))
    return Spots(place, contrast, direct)


def _sines(seen: Seen, table: Table, axis: int) -> list["_Sine"]:
    """Returns the sines of an axis from the longest period to the shortest."""
    periods = sorted({wave.period for wave in seen.order.sines if wave.axis == axis}, reverse=True)
    return [_Sine(seen, table, axis, period) for period in periods]


class _Sine:
    """Two phases of a sine along an axis, as the camera pixels saw them."""

    def __init__(self, seen: Seen, table: Table, axis: int, period: int) -> None:
        self._seen, self._period = seen, period
        numbers, size = seen.order.sine(axis, period), seen.order.projector[axis]
        waves = [seen.order.sines[number - FIRST_SINE] for number in numbers]
        light = table @ seen.grey_mixture
        self._lines = np.stack([light[wave.codes(size)] for wave in waves])  # (2, size)
        whole = light[waves[0].codes(period)]
        self._mean = float(whole.mean())
        turn = np.exp(2j * np.pi * (np.arange(period) + 0.5) / period)
        self._amplitude = float(2 * np.abs((whole * turn).mean()))
        self._shares = np.stack([seen.grey_share(number) for number in numbers])

    def _phase(self, shares: FloatArray) -> NDArray[np.complex128]:
        crest, quarter = (shares - self._mean) / self._amplitude
        return np.asarray(crest + 1j * quarter)

    def nearest(self, rough: FloatArray) -> FloatArray:
        """Returns the places with the captured phase that are nearest to rough places, (camera pixels,)."""
        found = np.angle(self._phase(self._shares)) * self._period / (2 * np.pi) - 0.5
        return np.asarray(found + self._period * np.round((rough - found) / self._period))

    def mended(self, place: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Returns places and contrasts of the Gaussians that reproduce the captures."""
        seen, weights = self._phase(self._shares), self._weights
        contrast = _neighbours(np.abs(seen), weights, self._seen.camera)
        observed, box = contrast, np.sinc(1 / self._period)
        contrast = contrast / box
        for _ in range(MENDED):
            expected = self._phase(self._expected(place, contrast))
            off = np.angle(seen * np.conj(expected)) * self._period / (2 * np.pi)
            place = place + np.where(np.abs(expected) > LEAST_CONTRAST / 2, off, 0)
            ratio = observed / np.maximum(_neighbours(np.abs(expected), weights, self._seen.camera), NARROWEST)
            contrast = np.clip(contrast * ratio, 0, 1)
        return place, contrast

    @cached_property
    def whole(self) -> BoolArray:
        """Whether the sine's contrast is above the noise, and about as high as the neighbours', (camera pixels,)."""
        shape, phase = self._seen.camera, np.abs(self._phase(self._shares))
        own = ndimage.median_filter(phase.reshape(shape), PHASE_SPREAD).ravel()
        around = _neighbours(phase, self._weights, shape)
        clarity = np.maximum(self._seen.clarity.sum(axis=1), 1e-9)
        return np.asarray((own > LEAST_CONTRAST) & (own > LEAST_DIRECT * around + CLEAR / np.sqrt(clarity)))

    @cached_property
    def _weights(self) -> FloatArray:
        """Weights of neighbours, capped at the median clarity, so that bright pixels do not dominate."""
        clarity = self._seen.clarity.sum(axis=1)
        usual = float(np.median(clarity[self._seen.lit])) if self._seen.lit.any() else 0.0
        return np.asarray(np.minimum(clarity, usual))

    def _expected(self, place: FloatArray, contrast: FloatArray) -> FloatArray:
        """Returns the shares that Gaussians would see, (2, camera pixels)."""
        columns, weights = along(place, width_of(contrast, self._period), REACH)
        size = self._lines.shape[1]
        inside = (columns >= 0) & (columns < size)
        weights = np.where(inside, weights, 0)
        weights /= np.maximum(weights.sum(axis=1, keepdims=True), 1e-9)
        lines = self._lines[:, np.clip(columns, 0, size - 1)]
        return np.asarray(np.einsum("pnw,nw->pn", lines, weights))


def width_of(contrast: FloatArray, period: int) -> FloatArray:
    """Returns σ, in pixels, of the Gaussian blur that reduces a sine of `period` pixels to this contrast."""
    kept = np.clip(contrast, NARROWEST, WIDEST)
    return np.asarray(np.sqrt(-np.log(kept) / (2 * np.pi**2)) * period)


def along(place: FloatArray, width: FloatArray, reach: int) -> tuple[IntArray, FloatArray]:
    """Returns the pixels around places along an axis, and a Gaussian's share in each, (n, 2 reach + 1) each."""
    pixels = np.rint(place).astype(np.int64)[:, None] + np.arange(-reach, reach + 1)
    scale = np.sqrt(2) * np.maximum(width, 1e-3)[:, None]
    edges = [erf((pixels + side - place[:, None]) / scale) for side in (-0.5, 0.5)]
    return pixels, np.asarray((edges[1] - edges[0]) / 2)


def _rough(seen: Seen, table: Table, sines: Sequence[_Sine], direct: BoolArray) -> FloatArray:
    """Returns the places by the ramps, smoothed, (camera pixels, 2), with the share of far light that fits best."""
    share, certain = _primary_shares(seen, RAMPS)
    mean = table[seen.codes[RAMPS], np.arange(3)].mean(axis=0)
    tried = [_by_ramps(seen, table, (share - far * mean) / (1 - far), certain, direct) for far in STRETCHES]
    return tried[int(np.argmin([_misfit(sines, each, direct) for each in tried]))]


def _by_ramps(seen: Seen, table: Table, share: FloatArray, certain: FloatArray, direct: BoolArray) -> FloatArray:
    """Find places from the ramps by least squares; the ramps rise along right, down and (right + down) / 2."""
    codes = np.linspace(0, 1, len(table))
    slopes = np.gradient(table, codes, axis=0)
    rows, first = np.array([[0, 1], [1, 0], [0.5, 0.5]]), DARKEST / 255  # derivatives along down, right
    place = np.full((len(share), 2), 0.5)
    for _ in range(STEPS):
        at = first + (1 - first) * place @ rows.T
        light, slope = (
            np.stack([np.interp(at[:, i], codes, of[:, i]) for i in range(3)], axis=1) for of in (table, slopes)
        )
        design = (1 - first) * slope[..., None] * rows
        squares = np.einsum("nl,nli,nlj->nij", certain, design, design) + np.eye(2)
        place = (
            place
            + np.linalg.solve(squares, np.einsum("nl,nli,nl->ni", certain, design, share - light)[..., None])[..., 0]
        )
        place = np.stack([_median(np.clip(each, 0, 1), direct, seen.camera, RAMP_SPREAD) for each in place.T], axis=1)
    return place * seen.order.projector - 0.5


def _misfit(sines: Sequence[_Sine], rough: FloatArray, direct: BoolArray) -> float:
    """Returns the mean distance of rough places to the nearest place that has the captured phase."""
    off = [np.abs(sine.nearest(each) - each)[direct] for sine, each in zip(sines, rough.T, strict=True)]
    return float(np.mean(off)) if direct.any() else 0.0


def _primary_shares(seen: Seen, picture: int) -> tuple[FloatArray, FloatArray]:
    """Returns each primary's share of a picture, (camera pixels, 3), and the inverse of its variance."""
    F, weights = seen.primaries, 1 / seen.room.noise.sigma(seen.above[picture]) ** 2
    squares = np.einsum("nkl,nk,nkm->nlm", F, weights, F)
    squares += 1e-6 * np.trace(squares, axis1=1, axis2=2)[:, None, None] * np.eye(3) + 1e-12 * np.eye(3)
    sums = np.einsum("nkl,nk,nk->nl", F, weights, seen.above[picture])
    inverse = np.linalg.inv(squares)
    certain = 1 / np.maximum(np.diagonal(inverse, axis1=1, axis2=2), 1e-12)
    return np.einsum("nlm,nm->nl", inverse, sums), np.where(seen.lit[:, None], certain, 0)


def _median(values: FloatArray, known: BoolArray, shape: Sequence[int], side: int) -> FloatArray:
    """Returns the median around each pixel; unknown pixels first take the nearest known value."""
    if not known.any():
        return values
    filled = values.reshape(shape)
    if not known.all():
        nearest = ndimage.distance_transform_edt(~known.reshape(shape), return_distances=False, return_indices=True)
        filled = filled[tuple(nearest)]
    return np.asarray(ndimage.median_filter(filled, side, mode="nearest")).ravel()


def _neighbours(values: FloatArray, weights: FloatArray, shape: Sequence[int]) -> FloatArray:
    """Returns weighted means over the neighbours of each pixel."""
    return averaged(values, weights, shape, WIDTH_SPREAD)


def averaged(values: FloatArray, weights: FloatArray, shape: Sequence[int], sigma: float) -> FloatArray:
    """Returns weighted means under a Gaussian, (camera pixels,); 0 far from any weight."""
    total, sums = (
        ndimage.gaussian_filter(each.reshape(shape), sigma, mode="constant").ravel()
        for each in (weights, weights * values)
    )
    return np.asarray(np.divide(sums, total, out=np.zeros_like(sums), where=total > 0))

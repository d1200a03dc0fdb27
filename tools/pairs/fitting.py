"""Fit a room to pairs: places, response or φ, gains of captures, and the model of each camera pixel."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import BoolArray, FloatArray
from counterlight.errors import InputError
from counterlight.tools.pairs.geometry import MOST_PAIRS, NO_MATCH, Pictures, Places, find_places, refined, regression
from counterlight.tools.pairs.model import CELLS, SATURATED, Model, fit
from counterlight.tools.pairs.processing import OWN, Processing, fit_processing, fit_response, level_shares

ROUNDS = 2  # rounds that fit response and places in turn
PATCH = (5, 5)  # side of a patch in camera pixels
FLAT, FLATTEST = 0.03, 0.2  # deviation of code values around places where the response is fitted; share of places
SAMPLES, LEAST_SAMPLES = 200_000, 1000
LIT_SHARE = 0.9  # quantile of the light, above which the projector lights a camera pixel even in a wide view
# largest share of saturated lit values; least deviation of code values over the pairs
MOST_SATURATED, LEAST_VARIED = 0.25, 0.02
LIT = 0.5  # least correlation of a directly lit camera pixel
FOREIGN = 0.5  # least correlation of a capture and its prediction
MOST_GAIN = 1.1
DARK = 1e-6  # a smaller sum of squared radiance is too dark to estimate a gain
# least light as a share of the camera's range; least number of camera pixels that determine a gain
LEAST_LIGHT, LEAST_PIXELS = 0.01, 300
FOLDS = 4  # parts of the pairs that are predicted by a fit of the other parts
# MOVED: shift in camera pixels; SEARCH: largest shift that is tried; CLEARER: correlation that a real shift gains
MOVED, SEARCH, CLEARER = 1.0, 8, 0.02


@dataclass(frozen=True)
class Border:
    """Evidence for the gain of a capture, from camera pixels that the projector does not light directly.

    ln gain = share (ln g − ln usual), with g the least-squares gain of these pixels: captured over predicted light.

    pixels : (height, width) bool.
    usual : (3,). Mean g of the pairs.
    share : part of g that is the gain of the whole capture; 0 if these pixels give no evidence.
    """

    pixels: BoolArray
    usual: FloatArray
    share: float

    @classmethod
    def fit(cls, predicted: Pictures, captures: Pictures, gains: FloatArray, lit: BoolArray) -> "Border":
        """Compare the gains of captures with the gains of their borders; predictions are at gain 1."""
        pixels = cv2.erode((~lit).astype(np.uint8), np.ones(PATCH)).astype(bool)
        if pixels.sum() < LEAST_PIXELS:
            return cls(pixels, np.ones(3), 0.0)
        seen, true = (np.log(each) for each in (_ratios(predicted, captures, pixels), gains))
        usual = seen.mean(axis=0)
        seen, true = seen - usual, true - true.mean(axis=0)
        share = np.clip((seen * true).sum() / max(float((seen * seen).sum()), 1e-12), 0, 1)
        return cls(pixels, np.exp(usual), float(share))

    def gains(self, predicted: Pictures, captures: Pictures) -> FloatArray:
        """Estimate the gains of captures, (captures, 3), from their predictions at gain 1."""
        if self.share == 0:
            return np.ones((len(captures), 3))
        relative = _ratios(predicted, captures, self.pixels) / self.usual
        return np.asarray(np.clip(relative**self.share, 1 / MOST_GAIN, MOST_GAIN))


def _ratios(predicted: Pictures, captures: Pictures, pixels: BoolArray) -> FloatArray:
    expected, found = (np.maximum(each[:, pixels].astype(np.float64), 0) for each in (predicted, captures))
    return np.asarray(((expected * found).sum(axis=1) + DARK) / ((expected * expected).sum(axis=1) + DARK))


@dataclass(frozen=True)
class Fitted:
    """A room as fitted to its pairs.

    processing : code values to light.
    factor : projector pixels per side of a pixel of the reduced pictures that places refer to.
    gains : (pairs, 3). Gain of each capture.
    unsteady : (pairs,) bool. Captures whose gain is beyond MOST_GAIN, which the fit uses instead.
    lit : (height, width) bool. Camera pixels that the projector lights directly.
    border : evidence for gains from the other camera pixels.
    """

    places: Places
    processing: Processing
    model: Model
    factor: int
    gains: FloatArray
    unsteady: BoolArray
    lit: BoolArray
    border: Border

    def shown(self, pictures: NDArray[np.uint8]) -> Pictures:
        """Return the light of pictures as the camera sees it without spread, (pictures, height, width, 3)."""
        return np.stack([self.places.warped(each) for each in light_of(pictures, self.processing, self.factor)])

    def predict(self, pictures: NDArray[np.uint8]) -> Pictures:
        """Predict the captures of pictures, at gain 1."""
        return self.model.predict(self.shown(pictures))


def light_of(pictures: NDArray[np.uint8], processing: Processing, factor: int) -> Pictures:
    """Return the light of pictures at the raster that places refer to."""
    return np.stack([reduced(processing.light(each / 255), factor) for each in pictures])


def reduced(light: NDArray[np.floating], factor: int) -> NDArray[np.floating]:
    height, width = light.shape[:2]
    size = (-(-width // factor), -(-height // factor))
    padded = cv2.copyMakeBorder(light, 0, -height % factor, 0, -width % factor, cv2.BORDER_REPLICATE)
    return np.asarray(cv2.resize(padded, size, interpolation=cv2.INTER_AREA), np.float32)


def fit_pairs(pictures: NDArray[np.uint8], captures: Pictures, *, additive: bool) -> Fitted:
    """Fit a room.

    pictures : code values, (pairs, projector height, projector width, 3).
    captures : linear light, (pairs, camera height, camera width, 3).
    additive : whether the light of a primary depends on its own code only, as a calibration requires.

    Raises InputError if the captures do not show the pictures, are saturated, or all alike.
    """
    _check(pictures, captures)
    factor = max(1, round(pictures.shape[2] / captures.shape[2]))
    codes = np.stack([reduced(each / np.float32(255), factor) for each in pictures])
    places = find_places(codes**2.2, captures)
    processing = Processing.of_gamma(2.2)
    for _ in range(ROUNDS):
        light = light_of(pictures, processing, factor)
        places = refined(light, captures, places, 1)
        processing = _response(places, pictures, light, captures, factor, additive=additive)
    light = light_of(pictures, processing, factor)
    shown = np.stack([places.warped(each) for each in light])
    clarity = regression(shown, captures)[2].min(axis=-1)
    lit = (clarity > LIT) & inside(places, light.shape[1:3])
    if lit.mean() < 0.01:
        raise InputError(NO_MATCH)
    coarse = fit(shown, captures, cells=CELLS[:1], linear=additive)
    measured = capture_gains(coarse.predict(shown), captures, lit)
    unsteady = np.asarray(((measured > MOST_GAIN) | (measured < 1 / MOST_GAIN)).any(axis=1))
    gains = np.clip(measured, 1 / MOST_GAIN, MOST_GAIN)
    gains /= np.exp(np.log(gains).mean(axis=0))
    direct = _direct(captures, gains, coarse.halo(shown))
    processing = _response(places, pictures, light, direct, factor, additive=additive)
    shown = np.stack([places.warped(each) for each in light_of(pictures, processing, factor)])
    model = fit(shown, captures, gains=gains, linear=additive)
    border = Border.fit(model.predict(shown), captures, gains, lit)
    return Fitted(places, processing, model, factor, gains, unsteady, lit, border)


@dataclass(frozen=True)
class Part:
    """Some pairs, and the model fitted to all other pairs."""

    pairs: NDArray[np.intp]
    model: Model


def parts_of(fitted: Fitted, pictures: NDArray[np.uint8], captures: Pictures, *, additive: bool) -> Iterator[Part]:
    """Fit a model to the pairs outside each of FOLDS parts.

    Places, response and gains of captures stay: they are few numbers, which all captures determine.
    """
    shown, everything = fitted.shown(pictures), np.arange(len(pictures))
    for part in np.array_split(everything, FOLDS):
        others = np.setdiff1d(everything, part)
        yield Part(part, fit(shown[others], captures[others], gains=fitted.gains[others], linear=additive))


def held_back(fitted: Fitted, parts: Iterable[Part], pictures: NDArray[np.uint8]) -> Pictures:
    """Predict the captures of each part of the pairs, at gain 1, by the model of the other parts."""
    predicted = [(part.pairs, part.model.predict(fitted.shown(pictures[part.pairs]))) for part in parts]
    order = np.argsort(np.concatenate([pairs for pairs, _ in predicted]))
    return np.concatenate([each for _, each in predicted])[order]


def inside(places: Places, shape: tuple[int, int]) -> BoolArray:
    """Return which camera pixels see the inside of a picture of this (height, width)."""
    x, y = places.places[1, ..., 0], places.places[1, ..., 1]
    return np.asarray((x > 0) & (y > 0) & (x < shape[1] - 1) & (y < shape[0] - 1))


def _check(pictures: NDArray[np.uint8], captures: Pictures) -> None:
    small = np.stack([cv2.resize(each, (32, 24), interpolation=cv2.INTER_AREA) for each in pictures]) / 255.0
    seen = np.stack([cv2.resize(each, (32, 24), interpolation=cv2.INTER_AREA) for each in captures])
    for k, primary in enumerate(("red", "green", "blue")):
        if np.median(small[..., k].std(axis=0)) < LEAST_VARIED:
            raise InputError(f"the pictures are all alike in {primary}; expected pictures that differ everywhere")
        if np.quantile(seen[..., k].std(axis=0), LIT_SHARE) < 1e-4:
            raise InputError(f"the photographs are all alike in {primary}; expected photographs of different pictures")
    bright = captures.max(axis=-1) >= SATURATED
    share = bright.mean(axis=(1, 2))
    if np.median(share) > MOST_SATURATED:
        raise InputError(
            f"{100 * np.median(share):.0f} % of a typical photograph is saturated, expected at most "
            f"{100 * MOST_SATURATED:.0f} %; photograph the pictures again with a shorter exposure"
        )


def _direct(captures: Pictures, gains: FloatArray, halo: Pictures) -> Pictures:
    """Return captures at gain 1 without their halo, which the response must not explain; saturated values stay."""
    direct = captures / gains[:, None, None].astype(np.float32) - halo
    return np.where(captures >= SATURATED, captures, direct)


def _response(
    places: Places, pictures: NDArray[np.uint8], light: Pictures, captures: Pictures, factor: int, *, additive: bool
) -> Processing:
    """Fit the response to means over patches, or φ where the pictures are flat, so that spread does not matter."""
    shown = np.stack([places.warped(each) for each in light])
    slope, offset, clarity = regression(shown, captures)
    good = (clarity.min(axis=-1) > LIT) & (slope.min(axis=-1) > 0.1 * np.median(slope.max(axis=-1)))
    good = cv2.erode(good.astype(np.uint8), np.ones(PATCH)).astype(bool)
    slope = np.where(good[..., None], slope, 1).astype(np.float32)
    samples = []
    rng = np.random.default_rng(0)
    used = np.unique(np.linspace(0, len(pictures) - 1, MOST_PAIRS if additive else len(pictures)).astype(int))
    for number in used:
        capture = captures[number]
        warped = places.warped(reduced(pictures[number] / np.float32(255), factor))
        mean = cv2.blur(warped, PATCH)
        deviation = np.sqrt(np.maximum(cv2.blur(warped * warped, PATCH) - mean**2, 0)).max(axis=-1)
        valid = good & (capture.max(axis=-1) < SATURATED)
        if not additive and valid.any():
            valid &= deviation <= max(FLAT, np.quantile(deviation[valid], FLATTEST))
        chosen = rng.permutation(np.flatnonzero(valid))[: SAMPLES // len(used)]
        told = (capture - offset) / slope
        told = cv2.blur(told, PATCH) if additive else told
        codes = _shares(places, pictures[number], factor, chosen) if additive else mean.reshape(-1, 3)[chosen]
        variance = ((0.003 + 0.05 * capture) / slope) ** 2 + 0.1 * deviation[..., None] ** 2
        samples.append((codes, *(each.reshape(-1, 3)[chosen] for each in (told, 1 / variance))))
    arrays = [np.concatenate(each).astype(np.float64) for each in zip(*samples, strict=True)]
    if len(arrays[0]) < LEAST_SAMPLES:
        raise InputError(NO_MATCH)
    return fit_response(*arrays) if additive else fit_processing(*arrays)


def _shares(places: Places, picture: NDArray[np.uint8], factor: int, chosen: NDArray[np.intp]) -> FloatArray:
    """Return the share of each level in the patches around some camera pixels, (pixels, 3, OWN)."""
    levels = [cv2.blur(places.warped(reduced(level_shares(picture, n), factor)), PATCH) for n in range(OWN)]
    return np.stack([level.reshape(-1, 3)[chosen] for level in levels], axis=-1)


def capture_gains(predicted: Pictures, captures: Pictures, lit: BoolArray) -> FloatArray:
    """Return the gain of each capture and channel, (pairs, 3); 1 where too few pixels are bright and not saturated."""
    gains = np.ones((len(predicted), 3))
    for number, (expected, capture) in enumerate(zip(predicted[:, lit], captures[:, lit], strict=True)):
        valid = (capture < SATURATED) & (expected > np.maximum(np.median(expected, axis=0), LEAST_LIGHT))
        for k in range(3):
            chosen = valid[:, k]
            if chosen.sum() >= LEAST_PIXELS:
                gains[number, k] = np.median(capture[chosen, k] / expected[chosen, k])
    return gains


@dataclass(frozen=True)
class Agreement:
    """How well each capture agrees with its prediction.

    likeness : (pairs,). Correlation of capture and prediction after each pixel's mean is removed.
    shift : (pairs,). Shift of the capture against its prediction in camera pixels, where it is clear; else 0.
    """

    likeness: FloatArray
    shift: FloatArray

    @property
    def moved(self) -> BoolArray:
        return np.asarray(self.shift > MOVED)

    @property
    def foreign(self) -> BoolArray:
        return np.asarray((self.likeness < FOREIGN) & ~self.moved)


def agreement(predicted: Pictures, captures: Pictures, lit: BoolArray) -> Agreement:
    """Compare captures with their predictions."""
    usual = np.median(predicted, axis=0)
    a, b = ((each - usual)[:, lit].reshape(len(predicted), -1) for each in (predicted, captures))
    likeness = (a * b).sum(axis=1) / np.maximum(np.sqrt((a * a).sum(axis=1) * (b * b).sum(axis=1)), 1e-12)
    shifts = [_shift(p.mean(axis=-1), c.mean(axis=-1), lit) for p, c in zip(predicted, captures, strict=True)]
    return Agreement(likeness, np.array(shifts))


def _shift(predicted: NDArray[np.floating], capture: NDArray[np.floating], lit: BoolArray) -> float:
    """Return by how many camera pixels a capture is shifted against its prediction; 0 if unclear."""
    rows, columns = (np.flatnonzero(lit.any(axis=axis)) for axis in (1, 0))
    if min(np.ptp(rows), np.ptp(columns)) <= 2 * SEARCH:
        return 0.0
    top, left = rows[0] + SEARCH, columns[0] + SEARCH
    inner = predicted[top : rows[-1] + 1 - SEARCH, left : columns[-1] + 1 - SEARCH]
    around = capture[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    likeness = cv2.matchTemplate(np.ascontiguousarray(around), np.ascontiguousarray(inner), cv2.TM_CCOEFF_NORMED)
    y, x = np.unravel_index(likeness.argmax(), likeness.shape)
    clear = likeness[y, x] > max(FOREIGN, likeness[SEARCH, SEARCH] + CLEARER)
    return float(np.hypot(y - SEARCH, x - SEARCH)) if clear else 0.0


def longest_run(flags: Sequence[bool]) -> int:
    best = run = 0
    for flag in flags:
        run = run + 1 if flag else 0
        best = max(best, run)
    return best

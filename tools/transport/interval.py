"""Prediction intervals: how far a captured pixel may be from its prediction, by split conformal prediction.

|c − ĉ| ≤ w(x, ĉ) holds for nine of ten pixels of an average capture, with ĉ = T p + e and, per channel,
w² = q² m(x) (a₀ + a₁ ĉ) + (z g ĉ)².

a is noise in the dark, and errors that grow with the light; least squares fit it to captures that were held back. m is
the squared error in a cell of the camera picture, relative to the usual one. q is the quantile of |c − ĉ| / s, with
w = q s, that the held-back captures require (Lei et al. 2018). For q, the m of a capture leaves this capture out. g is
the deviation of a wandering gain that the held-back captures do not have, and z a quantile of Student's t.
"""

from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from counterlight.arrays import BoolArray, FloatArray
from counterlight.calibration import INTERVAL, RADIANCE, REBUILD, StoredCalibration
from counterlight.tools.transport.arrays import ArrayError, StoredArray, opened_archive

Pictures = NDArray[np.floating]
NOMINAL = 0.9  # share of pixels that lie inside the interval
STUDENT = 1.753  # deviations that hold NOMINAL of gains whose deviation is known from 16 captures (Student's t)
STEADY = np.zeros(3)
CELL = 8  # camera pixels per side of a cell of m
USUAL = 4.0  # captures with the usual error that are averaged with a cell's captures
ROUNDS = 4  # rounds of weights in the fit of a
MOST_SAMPLES = 200_000  # pixels for the fit of a
WORDS = (40.0, "hardly visible errors"), (34.0, "small errors"), (28.0, "visible errors")  # from this PSNR in dB on
WORST = "clear errors"
LEAST = 1e-4  # least m; least s in the dark, as a share of the brightest prediction


@dataclass(frozen=True)
class Interval:
    """The half width w of a prediction interval.

    growth : (3, 2), ≥ 0. q² a of each channel.
    local : (cells down, cells across, 3), ≥ 0. m.
    gains : (3,), ≥ 0. g of each channel.
    """

    growth: NDArray[np.floating]
    local: NDArray[np.floating]
    gains: NDArray[np.floating] = field(default_factory=lambda: STEADY)

    def half_width(self, predicted: Pictures) -> Pictures:
        """Return w of a predicted camera picture, (height, width, 3), in its unit."""
        square = _at_pixels(self.local, predicted.shape[:2]) * _variance(predicted, self.growth)
        return np.asarray(np.sqrt(square + (STUDENT * self.gains * predicted) ** 2))

    def typical(self, predicted: Pictures, counted: BoolArray) -> float:
        """Return the median of w over the counted pixels of a predicted camera picture."""
        return float(np.median(self.half_width(predicted)[counted]))

    def inside(self, predicted: Pictures, captured: Pictures) -> BoolArray:
        """Return which values of a captured picture are in the interval, (height, width, 3)."""
        return np.asarray(np.abs(captured - predicted) <= self.half_width(predicted))


def fit_interval(predicted: Pictures, captured: Pictures, counted: BoolArray, gains: FloatArray = STEADY) -> Interval:
    """Fit an interval to captures that were held back, at least one.

    predicted, captured : linear light, (captures, height, width, 3). Each prediction was made without its capture.
    counted : (height, width) bool. Camera pixels that the interval is for.
    gains : (3,). Deviation of the captures' gains, if the predictions have these gains already.
    """
    growth = _fitted_growth(predicted, captured, counted)
    pairs = list(zip(predicted, captured, strict=True))
    ratios = np.stack([((c - p) ** 2 / _variance(p, growth)).astype(np.float32) for p, c in pairs])
    weight = _cell_means(np.repeat(counted[..., None], 3, axis=2).astype(np.float32))
    errors = np.stack([_cell_means(each * counted[..., None]) for each in ratios])
    usual = errors.sum(axis=(0, 1, 2)) / (len(errors) * weight.sum(axis=(0, 1)))

    def local(used: BoolArray) -> NDArray[np.floating]:
        mean = (errors[used].sum(axis=0) + USUAL * usual) / (used.sum() * weight + USUAL)
        return np.asarray(np.maximum(mean, LEAST))

    numbers = np.arange(len(errors))
    relative = [
        (each / _at_pixels(local(numbers != number), counted.shape))[counted] for number, each in enumerate(ratios)
    ]
    return Interval(growth * np.quantile(relative, NOMINAL), local(numbers >= 0).astype(np.float32), gains)


@dataclass(frozen=True)
class Coverage:
    """How many captured values lie inside an interval.

    captures : share of each capture.
    thirds : shares of the dark, middle and bright third by predicted light.
    width : mean of upper minus lower end.
    constant : width of the one interval for all values that contains as many.
    """

    captures: NDArray[np.floating]
    thirds: tuple[float, ...]
    width: float
    constant: float

    @property
    def share(self) -> float:
        return float(self.captures.mean())

    @property
    def parts(self) -> str:
        dark, middle, bright = (f"{100 * each:.1f}" for each in self.thirds)
        return f"dark {dark}, middle {middle}, bright {bright} %"


def coverage(half_width: Pictures, predicted: Pictures, captured: Pictures, counted: BoolArray) -> Coverage:
    """Count captured values, (captures, height, width, 3), within half widths of their predictions."""
    error = np.abs(captured - predicted)[:, counted]
    inside, light = error <= half_width[:, counted], predicted[:, counted]
    thirds = tuple(float(each.mean()) for each in np.array_split(inside.ravel()[np.argsort(light, axis=None)], 3))
    width, constant = 2 * half_width[:, counted].mean(), 2 * np.quantile(error, inside.mean())
    return Coverage(inside.mean(axis=(1, 2)), thirds, float(width), float(constant))


@dataclass(frozen=True)
class Expected:
    """How well captures match their predictions, from captures that were held back. The target plays no part.

    decibels : PSNR of captures against T p + e, relative to white.
    within : median half width of the prediction interval, as a share of white.
    """

    decibels: float
    within: float

    def __str__(self) -> str:
        return (
            f"expected on the wall: {self.words}. A capture matches its prediction to about {self.decibels:.1f} dB, "
            f"and 9 of 10 camera pixels typically to {100 * self.within:.1f} % of white; build and play state how "
            "close pictures come to the target"
        )

    @property
    def words(self) -> str:
        return next((words for least, words in WORDS if self.decibels >= least), WORST)

    @property
    def short(self) -> str:
        """The end of a command's last line."""
        return f"captures match the prediction to {self.decibels:.1f} dB ({self.words})"


def expected_quality(
    interval: Interval, predicted: Pictures, captured: Pictures, counted: BoolArray, white: float, noise: float = 0.0
) -> Expected:
    """Return how well captures of pictures like the held-back ones will match their predictions.

    white : light of a white picture.
    noise : share of the squared error that the camera's noise explains. Noise does not reach the wall.
    """
    error = float(np.mean((predicted - captured)[:, counted] ** 2)) * (1 - noise) / white**2
    widths = [np.median(interval.half_width(each)[counted]) for each in predicted]
    return Expected(float(-10 * np.log10(max(error, 1e-12))), float(np.median(widths)) / white)


def write_interval(interval: Interval, stage: Path) -> None:
    np.savez_compressed(stage / INTERVAL, growth=interval.growth, local=interval.local, gains=interval.gains)


def read_interval(stored: StoredCalibration) -> Interval | None:
    """Read a calibration's interval; None if it has none. Raises InputError for a damaged file."""
    if INTERVAL not in stored.files:
        return None
    down, across = (-(-side // CELL) for side in stored.calibration.camera.shape)
    with (
        stored.opened(INTERVAL) as file,
        opened_archive(file, "not the prediction interval of this calibration", REBUILD) as arrays,
    ):
        growth, local = arrays["growth"].expect("fiu", 3, 2), arrays["local"].expect("fiu", down, across, 3)
        gains = _read(arrays["gains"].expect("fiu", 3)) if "gains" in arrays else STEADY  # older rooms have none
        return Interval(_read(growth), _read(local), gains)


def _read(array: StoredArray) -> NDArray[np.floating]:
    values = array.read()
    if not (values.min() >= 0 and values.max() <= RADIANCE[1] ** 2):  # a comparison with NaN is false
        raise ArrayError(f"numbers from {values.min():g} to {values.max():g}, expected 0 to {RADIANCE[1] ** 2:g}")
    return values


def _variance(predicted: Pictures, growth: NDArray[np.floating]) -> Pictures:
    return np.asarray(growth[:, 0] + growth[:, 1] * np.maximum(predicted, 0))


def _fitted_growth(predicted: Pictures, captured: Pictures, counted: BoolArray) -> FloatArray:
    """Fit a₀ + a₁ ĉ ≥ 0 to squared errors, weighted by the inverse of what is fitted: (3, 2)."""
    every = max(1, len(predicted) * np.count_nonzero(counted) // MOST_SAMPLES)
    light, seen = (each[:, counted].reshape(-1, 3)[::every].astype(np.float64) for each in (predicted, captured))
    least = (LEAST * max(float(light.max()), float(np.finfo(np.float32).tiny))) ** 2
    growth = np.empty((3, 2))
    for k in range(3):
        square = (seen[:, k] - light[:, k]) ** 2 + least
        A = np.stack([np.ones_like(square), np.maximum(light[:, k], 0)], axis=1)
        expected = np.full_like(square, square.mean())
        for _ in range(ROUNDS):
            growth[k] = nnls(A / expected[:, None], square / expected)[0]
            expected = np.maximum(A @ growth[k], least)
    growth[:, 0] = np.maximum(growth[:, 0], least)
    return growth


def _cell_means(picture: Pictures) -> Pictures:
    """Return the means of CELL × CELL camera pixels, (cells down, cells across, 3); zeros lie outside the picture."""
    height, width = picture.shape[:2]
    padded = np.pad(picture, ((0, -height % CELL), (0, -width % CELL), (0, 0)))
    return np.asarray(padded.reshape(-(-height // CELL), CELL, -1, CELL, 3).mean(axis=(1, 3)))


def _at_pixels(cells: Pictures, shape: tuple[int, ...]) -> Pictures:
    """Interpolate values of cells at the camera pixels of a (height, width) picture."""
    y, x = (((np.arange(side) + 0.5) / CELL - 0.5).astype(np.float32) for side in shape)
    at = np.meshgrid(x, y)
    grid = cells.astype(np.float32)
    return np.asarray(cv2.remap(grid, at[0], at[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))

"""Measure the camera's curve (code value → light) from pictures whose light adds up, for any projector.

The projector pixels are divided into four parts of superposed cells of all sizes. Let L_m be the light of part m at a
camera pixel. Black, white, each part and each pair of parts then give g(z) = L_0 + Σ L_m, and a full grey of code v
gives L_0 + s_v Σ L_m. Curve g, shares s_v and the light of every camera pixel are unknown. Parts fix the exponent of g.
Greys, which have no edges that JPEG or sharpening could change, fix its shape.

The codes z have errors, so that minimising Σ (g(z) − light)² alone would flatten g. Each residual is therefore divided
by g'(z) σ, with σ the error of its code (errors in variables; Sampson 1982). The light of the pixels is eliminated, and
Gauss-Newton steps find log slopes of g and shares (variable projection; Golub and Pereyra 1973).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import BSpline
from scipy.ndimage import uniform_filter

from counterlight.arrays import BoolArray, FloatArray, IntArray
from counterlight.errors import InputError
from counterlight.response import Response
from counterlight.tools.acquisition.camera_files import traces
from counterlight.tools.acquisition.cameras.camera import LINEAR, Exposures, Shot
from counterlight.tools.acquisition.linearity import cells_of
from counterlight.tools.acquisition.plan import Picture
from counterlight.tools.hdr.camera_response import NODES, table_response

PARTS = 4
PAIRS = (0, 1), (2, 3), (0, 2), (1, 3), (0, 3), (1, 2)
GREYS = np.arange(32, 256, 32, dtype=np.uint8)
CURVE_PICTURES = PARTS + len(PAIRS) + len(GREYS)
SAMPLES = 1000  # camera pixels per channel
SPLINES, DEGREE = 24, 3
CONTRAST = 0.1  # error of a code as a share of the contrast around it: JPEG, sharpening, noise reduction
AROUND = 5  # side of the surroundings of a camera pixel
STEP = 0.3  # rounding error of a code in flat surroundings, in code values: 1/√12 of a step
FINEST = 1 / 1000  # share of the range; steps of finer cameras do not limit the fit
# standard deviation of the second differences of log slopes; with 0.1, the top 0.9 % of sRGB is continued wrongly
SMOOTH = 0.03
TOE = 0.05  # the fit starts with the best of these exponents of code + TOE
EXPONENTS = 0.6, 0.8, 1.0, 1.3, 1.6, 2.0, 2.4, 3.0
STEPS, ENOUGH = 20, 1e-5  # Gauss-Newton steps; relative gain of a step that ends the fit
ROBUST = 3.0  # multiple of the median misfit; pixels beyond it count much less
LEAST_CLEAR = 20  # least rise of white above black, in multiples of a code's step
FEWEST = 100  # camera pixels that a fit needs
# share of white; a curve that is closer to a straight line counts as linear (a linear JPEG of quality 75: 1.4 %)
STRAIGHT = 0.02
SURELY = 3.0  # multiple of the curve's error; a curve that is closer to a straight line counts as linear
# share of the camera's pixels that see no light under black; largest gain g in these pixels, relative to white's g
DARKEST, DARK = 0.005, 0.02


@dataclass(frozen=True)
class Curve:
    """A measured curve.

    response : the curve; linear if it cannot be distinguished from a straight line.
    error : RMS error of the light as a share of white, from the difference between curves of two halves of the pixels.
    bent : largest difference from a straight line between black and white, as a share of white.
    files : what the camera does to its pictures, in words.
    """

    response: Response
    error: float
    bent: float
    files: str = ""

    @property
    def is_straight(self) -> bool:
        return self.response == LINEAR

    def __str__(self) -> str:
        if self.is_straight:
            return f"{self.files}; linear to {100 * self.bent:.1f} % of white"
        return (
            f"{self.files}; a curve, measured to {100 * self.error:.2g} % of white, up to {100 * self.bent:.0f} % off "
            "a linear camera"
        )


def curve_pictures(projector: tuple[int, int]) -> list[Picture]:
    """Returns the parts, the pairs of parts, and the greys."""
    parts = cells_of(projector, PARTS).argmax(axis=0)
    shown: list[Picture] = [np.asarray(parts == part) for part in range(PARTS)]
    shown += [np.asarray((parts == first) | (parts == second)) for first, second in PAIRS]
    return shown + [np.full((*projector, 3), grey, np.uint8) for grey in GREYS]


def curve_of(shots: Sequence[Sequence[Shot]], exposures: Exposures, again: Sequence[Shot] | None = None) -> Curve:
    """Measure the curve from captures of black, white and `curve_pictures`.

    shots : captures of each picture.
    again : another capture of white, which reveals noise reduction.
    """
    usable = ~(exposures.saturated(shots[0]) | exposures.saturated(shots[1]))
    codes = [exposures.codes(each) for each in shots]
    white = [codes[1]] if again is None else [codes[1], exposures.codes(again)]
    kind = shots[0][0].dtype
    files = traces(white, codes[2 : -len(GREYS)], eight_bits=kind == np.uint8)
    return replace(measure_curve(codes, usable, 1 / float(np.iinfo(kind).max)), files=files)


def measure_curve(codes: Sequence[FloatArray], usable: BoolArray, step: float) -> Curve:
    """Fit the curve to captures of black, white and `curve_pictures`.

    codes : (camera height, camera width, 3) each. Code values, 0 to 1.
    usable : (camera height, camera width). Pixels that are not saturated.
    step : error of a code, in code values.

    Raises InputError if the projector lights too few pixels.
    """
    data = _sampled(codes, usable, max(step, FINEST))
    fit = _Fit(data).run()
    halves = [_Fit(data.half(half), fit.slopes).run() for half in (0, 1)]
    dark, white = (float(np.median(data.codes[:, picture])) for picture in (0, 1))
    at = np.linspace(dark, white, NODES)
    curves = [_between(each.light(at)) for each in (fit, *halves)]
    error = float(np.sqrt(np.mean((curves[1] - curves[2]) ** 2))) / 2
    bent = float(np.abs(curves[0] - np.linspace(0, 1, NODES)).max())
    column = fit.light(np.linspace(0, 1, NODES))
    nothing = _nothing(fit, codes[0], codes[1])
    column = np.maximum(column - nothing, 0) / (column[-1] - nothing)
    straight = bent <= max(STRAIGHT, SURELY * error)
    return Curve(LINEAR if straight else table_response(column[:, None]), error, bent)


def _between(light: FloatArray) -> FloatArray:
    """Returns light as shares of the way from the first to the last value."""
    return np.asarray((light - light[0]) / (light[-1] - light[0]))


def _nothing(fit: "_Fit", black: FloatArray, white: FloatArray) -> float:
    """Returns g of no light, from the darkest pixels under black; 0 if the room's light reaches them."""
    darkest, brightest = fit.light(np.array([np.quantile(black, DARKEST), np.quantile(white, 1 - DARKEST)]))
    return float(darkest) if darkest <= DARK * brightest else 0.0


@dataclass(frozen=True)
class _Data:
    """Codes of sampled camera pixels and channels.

    codes, errors : (samples, pictures). Code values, 0 to 1, and their standard deviations.
    channels : (samples,). Channel of each sample.
    """

    codes: FloatArray
    errors: FloatArray
    channels: IntArray

    def half(self, half: int) -> "_Data":
        return _Data(self.codes[half::2], self.errors[half::2], self.channels[half::2])


def _sampled(codes: Sequence[FloatArray], usable: BoolArray, step: float) -> _Data:
    """Returns the samples: pixels that are lit in all channels, at random but always the same."""
    lit = usable & np.all(codes[1] - codes[0] > LEAST_CLEAR * step, axis=2)
    pixels = np.flatnonzero(lit)
    if len(pixels) < FEWEST:
        raise InputError(
            f"the projector lights {len(pixels)} camera pixels well enough to measure the camera's curve, expected "
            f"{FEWEST} or more; expose longer, or give the curve with --camera-response"
        )
    pixels = np.random.default_rng(len(pixels)).permutation(pixels)[:SAMPLES]
    seen = np.stack([each.reshape(-1, 3)[pixels] for each in codes])
    around = np.stack([_contrast(each).reshape(-1, 3)[pixels] for each in codes])
    errors = np.sqrt((STEP * step) ** 2 + (CONTRAST * around) ** 2)
    channels = np.tile(np.arange(3), len(pixels))
    return _Data(seen.reshape(len(codes), -1).T, errors.reshape(len(codes), -1).T, channels)


def _contrast(picture: FloatArray) -> FloatArray:
    """Returns the standard deviation of the code values around each pixel."""
    mean, square = (uniform_filter(each, AROUND, axes=(0, 1)) for each in (picture, picture**2))
    return np.asarray(np.sqrt(np.maximum(square - mean**2, 0)))


class _Fit:
    """The least squares problem, and its solution after `run`.

    slopes : (SPLINES − 1,). Logarithms of the rises of g's coefficients.
    shares : (3, greys). s_v of each channel.
    """

    def __init__(self, data: _Data, slopes: FloatArray | None = None) -> None:
        self._data = data
        rises = np.tri(SPLINES, SPLINES - 1, -1)
        self._value, self._slope = (_design(data.codes, order) @ rises for order in (0, 1))
        self._sums = _sums()
        starts = [slopes] if slopes is not None else [_power(exponent) for exponent in EXPONENTS]
        self.shares = np.zeros((3, len(GREYS)))
        tried = []
        for start in starts:
            self.slopes = start
            self._share_greys()
            tried.append(float(np.median(self._misfit(self._state(self.slopes, self.shares)))))
        self._prior = self.slopes = starts[int(np.argmin(tried))]
        self._share_greys()

    def light(self, codes: FloatArray) -> FloatArray:
        """Returns g of code values, with g(0) = 0."""
        return np.asarray(_design(codes, 0) @ np.concatenate([[0], np.cumsum(np.exp(self.slopes))]))

    def run(self) -> "_Fit":
        damping, state = 1e-3, self._state(self.slopes, self.shares)
        for _ in range(STEPS):
            misfit = self._misfit(state)
            typical = max(float(np.median(misfit)), np.finfo(float).tiny)
            weights = 1 / (1 + misfit / (ROBUST * typical)) ** 2
            bending = np.diff(np.eye(SPLINES - 1), 2, axis=0)
            penalty = bending.T @ bending * typical / SMOOTH**2
            hessian, gradient = self._normal(state, weights)
            hessian[: SPLINES - 1, : SPLINES - 1] += penalty
            gradient[: SPLINES - 1] += penalty @ (self.slopes - self._prior)
            before = self._cost(state, weights, penalty, self.slopes)
            after = before
            while damping < 1e6:
                damped = hessian + np.diag(damping * np.diag(hessian) + np.finfo(float).tiny)
                change = -np.linalg.lstsq(damped, gradient, rcond=None)[0]
                slopes = self.slopes + np.clip(change[: SPLINES - 1], -1, 1)
                slopes -= np.log(np.exp(slopes).sum())
                shares = np.clip(self.shares + change[SPLINES - 1 :].reshape(3, -1), 0, 2)
                state_then = self._state(slopes, shares)
                after = self._cost(state_then, weights, penalty, slopes)
                if after < before:
                    self.slopes, self.shares, state = slopes, shares, state_then
                    damping = max(damping / 5, 1e-7)
                    break
                damping *= 8
            if before - after <= ENOUGH * before:
                break
        return self

    def _share_greys(self) -> None:
        """Set the shares of the greys to the most likely ones for the present curve."""
        light = self._value @ np.exp(self.slopes)
        whole = light[:, 1] - light[:, 0]
        first = light.shape[1] - len(GREYS)
        for channel in range(3):
            own = self._data.channels == channel
            above = light[own, first:] - light[own, :1]
            self.shares[channel] = np.clip(whole[own] @ above / max(whole[own] @ whole[own], 1e-12), 0, 2)

    def _state(self, slopes: FloatArray, shares: FloatArray) -> "_State":
        rises = np.exp(slopes)
        spread = np.maximum(self._slope @ rises, 1e-6) * self._data.errors
        sums = np.repeat(self._sums[None], len(spread), axis=0)
        sums[:, -len(GREYS) :, 1:] = shares[self._data.channels][:, :, None]
        A = sums / spread[..., None]
        inverse = np.asarray(np.linalg.inv(A.transpose(0, 2, 1) @ A), np.float64)
        light = (self._value @ rises) / spread
        parts = (inverse @ (A.transpose(0, 2, 1) @ light[..., None]))[..., 0]
        return _State(rises, spread, A, inverse, parts, light - (A @ parts[..., None])[..., 0])

    def _misfit(self, state: "_State") -> FloatArray:
        return np.asarray(np.sum(state.residual**2, axis=1) / (self._sums.shape[0] - self._sums.shape[1]))

    def _cost(self, state: "_State", weights: FloatArray, penalty: FloatArray, slopes: FloatArray) -> float:
        off = slopes - self._prior
        return float(weights @ np.sum(state.residual**2, axis=1) + off @ penalty @ off)

    def _normal(self, state: "_State", weights: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Returns JᵀJ and Jᵀr of slopes and shares; the light of the parts is projected out of J."""
        slopes, greys = SPLINES - 1, len(GREYS)
        J = np.zeros((*state.residual.shape, slopes + 3 * greys))
        sharper = state.residual[..., None] * self._slope * (self._data.errors / state.spread)[..., None]
        J[..., :slopes] = (self._value / state.spread[..., None] - sharper) * state.rises
        whole = state.parts[:, 1:].sum(axis=1)
        every = np.arange(len(J))
        for grey in range(-greys, 0):
            J[every, grey, slopes + self._data.channels * greys + greys + grey] = -whole / state.spread[:, grey]
        along = state.A.transpose(0, 2, 1) @ J
        J -= state.A @ (state.inverse @ along)
        weighted = (J * weights[:, None, None]).reshape(-1, J.shape[-1])
        return weighted.T @ J.reshape(weighted.shape), weighted.T @ state.residual.ravel()


@dataclass(frozen=True)
class _State:
    """The least squares problem, linearised at one curve.

    rises : (SPLINES − 1,). Rises of g's coefficients.
    spread : (samples, pictures). Standard deviation of the light.
    A, inverse : sums of the parts' light, divided by `spread`, and (AᵀA)⁻¹, for each sample.
    parts : (samples, 1 + PARTS). L_0 and the light of the parts.
    residual : (samples, pictures).
    """

    rises: FloatArray
    spread: FloatArray
    A: FloatArray
    inverse: FloatArray
    parts: FloatArray
    residual: FloatArray


def _sums() -> FloatArray:
    """Returns the share of L_0 and of each part's light in each picture, (pictures, 1 + PARTS); 0 for greys."""
    lit = [(), range(PARTS), *((part,) for part in range(PARTS)), *PAIRS, *[()] * len(GREYS)]
    return np.array([[1, *(part in each for part in range(PARTS))] for each in lit], np.float64)


def _knots() -> FloatArray:
    inner = np.linspace(0, 1, SPLINES - DEGREE + 1)
    return np.concatenate([np.zeros(DEGREE), inner, np.ones(DEGREE)])


def _design(codes: FloatArray, order: int) -> FloatArray:
    """Returns the B-splines at code values, or their derivatives: (…,) -> (…, SPLINES)."""
    knots, at = _knots(), np.clip(codes, 0, 1).ravel()
    if order == 0:
        return np.asarray(BSpline.design_matrix(at, knots, DEGREE).toarray()).reshape(*codes.shape, SPLINES)
    lower = BSpline.design_matrix(at, knots[1:-1], DEGREE - 1).toarray()
    widths = DEGREE / (knots[DEGREE + 1 : -1] - knots[1 : -DEGREE - 1])
    return np.asarray(lower * widths @ np.diff(np.eye(SPLINES), axis=0)).reshape(*codes.shape, SPLINES)


def _power(exponent: float) -> FloatArray:
    """Returns the log slopes of (code + TOE)^exponent."""
    knots = _knots()
    places = np.array([knots[i + 1 : i + 1 + DEGREE].mean() for i in range(SPLINES)])
    rises = np.diff((places + TOE) ** exponent)
    return np.asarray(np.log(rises / rises.sum()))

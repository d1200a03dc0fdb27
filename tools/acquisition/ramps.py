"""Measure the projector's response and primaries, from ramps of grey, red, green and blue before any pattern.

A primary's ramp is compared with its floodlight F, the mean of many captures of full red, green or blue. With noise σ,
the best estimate of h in c − black = h F is ⟨W, c − black⟩ / ⟨W, F⟩ with W = F / σ², over all camera channels and all
well-lit pixels. Mixed channels therefore do not matter, and channels with more light count more. Code 0 is the black
and grey 255 the floodlight that are measured already.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.optimize import isotonic_regression

from counterlight.arrays import FloatArray
from counterlight.errors import InputError
from counterlight.response import Response, WhiteSegment
from counterlight.tools.acquisition.plan import REPEATS, Codes, LazyPatterns, Level, Reference
from counterlight.tools.hdr.projector_response import exponent, fit_projector_response
from counterlight.tools.transport.transport import Transport

CODES = np.rint(np.linspace(0, 255, 17)).astype(np.uint8)
INNER = CODES[1:-1]
COLOURS = np.array([[1, 1, 1], [1, 0, 0], [0, 1, 0], [0, 0, 1]], np.uint8)  # grey and the primaries
FULL = CODES[-1]
PRIMARIES = len(INNER) * len(COLOURS)  # index of the first capture of a primary, after the ramps
WELL_LIT = 10  # light of a well-lit pixel, in multiples of the noise of a dark capture
MOST_UNADDED = 0.03  # colours may miss white by this share of white, plus SURELY times the noise:
SURELY = 4
SAMPLES = 65  # samples of a white segment
UNSEEN = 1e-6  # share of the brightest primary's squared light, below which a primary counts as unseen
BENT = 0.01  # usual second difference of log light − γ log code at full drive; inverse to the code at others
EXACT = 1e-6  # least error assumed of a capture, as a share of the brightest light


@dataclass(frozen=True)
class ProjectorLight:
    """The light that the projector gives per code value. All shares are of white.

    response : measured response of each channel.
    gammas : closest exponent of each channel.
    primaries : (3, camera height, camera width, 3) float32. Radiance above black of full red, green or blue alone.
    fitted : largest change that made the readings smooth and monotone.
    noise : largest standard deviation of a reading.
    unadded : (17,). Grey minus the sum of the primaries at each of `CODES`.
    unadded_noise : standard deviation of `unadded`.
    segment : white segment that explains `unadded`; None if light adds up or no segment explains it.
    crosstalk : share of a camera channel's light that neighbouring primaries give.
    """

    response: Response
    gammas: tuple[float, ...]
    primaries: NDArray[np.float32]
    fitted: float
    noise: float
    unadded: FloatArray
    unadded_noise: float
    segment: WhiteSegment | None
    crosstalk: float

    @property
    def fit(self) -> str:
        """How the response was measured, in words."""
        gammas = ", ".join(f"{gamma:.2f}" for gamma in self.gammas)
        return (
            f"measured at {len(CODES)} levels a channel, about gamma {gammas}; off the readings by at most "
            f"{100 * self.fitted:.2g} % of white, their noise {100 * self.noise:.2g} %"
        )

    def curve(self, given: Response) -> Response:
        """Returns another response combined with the measured white segment or colour processing."""
        return replace(given, segment=self.response.segment, processing=self.response.processing)

    @property
    def is_explained(self) -> bool:
        """Whether light adds up, or the response says how it does not."""
        return self.adds_up or self.response.segment is not None or self.response.processing is not None

    @property
    def adds_up(self) -> bool:
        return _adds_up(self.unadded, self.unadded_noise)

    def without_segment(self, transport: Transport, segment: WhiteSegment) -> Transport:
        """Convert T measured with white to T of the sum of the primaries, which is the light of drive 1."""
        lights = np.maximum(self.primaries.reshape(3, -1, 3).astype(np.float64), 0)
        primaries = lights.sum(axis=0)
        white = np.einsum("l,lik->ik", segment.white(), lights)
        share = np.divide(primaries, white, out=np.full_like(white, 1 / segment.white().mean()), where=white > 0)
        return transport.scaled(share)


def light_level(projector: tuple[int, int]) -> Level:
    """Returns the level of grey and primaries: all inner codes once, then full drive as often as the floodlight."""
    colours = np.concatenate([*(COLOURS * code for code in INNER), *[COLOURS[1:] * FULL] * REPEATS])

    def paint(number: int) -> Codes:
        return np.full((*projector, 3), colours[number], np.uint8)

    return Level("ramps and primaries", LazyPatterns(len(colours), paint))


def measure_light(captures: Sequence[NDArray[np.floating]], room: Reference, spread: FloatArray) -> ProjectorLight:
    """Evaluate the captures of `light_level`; InputError if all well-lit pixels are saturated.

    spread : (3,). Standard deviation of a capture's gain, per channel; 0 for a steady camera.
    """
    primaries = [_mean(room, captures, range(PRIMARIES + i, len(captures), 3)) for i in range(3)]
    templates = [_Template(room, light) for light in (room.light, *primaries)]
    white = templates[0]
    if not white.tells:
        raise InputError(
            "ramps: every camera pixel that the projector lights well is saturated; shorten the exposure (or add a "
            "shorter one) and capture again"
        )
    own, whole = (np.ones((len(CODES), len(COLOURS))) for _ in range(2))  # shares of the colour's template and white
    own[0], whole[0] = 0, 0
    whole[-1] = [white.share(light) for light in (room.light, *primaries)]
    parts = Primaries(room, primaries)
    added = np.zeros((len(CODES), 3))
    added[-1] = parts.shares(room.light - sum(primaries))
    for code in range(1, len(INNER) + 1):
        first = (code - 1) * len(COLOURS)
        lights = [room.above_black(captures[first + colour]) for colour in range(len(COLOURS))]
        own[code] = [template.share(light) for template, light in zip(templates, lights, strict=True)]
        whole[code] = [white.share(light) for light in lights]
        added[code] = parts.shares(lights[0] - sum(lights[1:]))
    # an unseen primary uses the template of grey
    chosen = [colour if templates[colour].tells else 0 for colour in (1, 2, 3)]
    readings, noises = own[:, chosen], [templates[colour].noise for colour in chosen]
    if spread.any():
        for shares, each in zip(readings.T, noises, strict=True):
            shares[1:] = smoothed(shares[1:], float(spread.max()), each)
    fitted = fit_projector_response(CODES / 255.0, readings, np.where(np.isin(CODES, INNER), 1, REPEATS))
    unadded, noise = whole[:, 0] - whole[:, 1:].sum(axis=1), 2 * white.noise  # noise of four captures
    return ProjectorLight(
        fitted.response,
        fitted.gammas,
        np.stack(primaries).reshape(3, *room.black.shape).astype(np.float32),
        fitted.pooled + float(np.abs(readings - own[:, chosen]).max()),
        max(noises),
        unadded,
        noise,
        None if _adds_up(unadded, noise) else _segment(fitted.response, added),
        crosstalk(np.stack(primaries), room),
    )


def smoothed(shares: FloatArray, spread: float, noise: float) -> FloatArray:
    """Smooth a ramp's shares at `CODES[1:]`, whose captures have unknown gains.

    Least squares fit log share − γ log code, with a prior of small second differences. The last share is the mean of
    REPEATS captures.

    spread : standard deviation of a gain.
    noise : standard deviation of a share without gains.
    """
    codes, known = CODES[1:] / 255.0, np.maximum(shares, noise)
    gamma = exponent(codes, known)
    weights = 1 / (spread**2 + (noise / known) ** 2)
    weights[-1] *= REPEATS
    bends = np.diff(np.eye(len(codes)), 2, axis=0) * codes[1:-1, None] / BENT
    off = np.linalg.solve(bends.T @ bends + np.diag(weights), weights * (np.log(known) - gamma * np.log(codes)))
    return np.asarray(codes**gamma * np.exp(off))


def _adds_up(unadded: FloatArray, noise: float) -> bool:
    return bool(np.abs(unadded).max() <= MOST_UNADDED + SURELY * noise)


def _segment(response: Response, added: FloatArray) -> WhiteSegment | None:
    """Returns the white segment that gives this light (17, 3) at the greys of `CODES`; None if no segment does."""
    levels, places = np.unique(response.to_linear(_grey(CODES)).min(axis=1), return_inverse=True)
    rising = np.stack([isotonic_regression(column).x for column in added.T], axis=1)
    light = np.stack([np.bincount(places, column) / np.bincount(places) for column in np.maximum(rising, 0).T], axis=1)
    light -= light[0]
    with suppress(InputError):
        table = PchipInterpolator(levels, light)(np.linspace(0, 1, SAMPLES))
        return WhiteSegment(tuple(tuple(float(value) for value in row) for row in table))
    return None


def _grey(codes: NDArray[np.uint8]) -> FloatArray:
    return np.repeat(codes[:, None] / 255.0, 3, axis=1)


def _mean(room: Reference, captures: Sequence[NDArray[np.floating]], numbers: range) -> FloatArray:
    """Returns the mean light above black, (camera pixels, 3), with one capture in memory at a time."""
    total = np.zeros_like(room.light)
    for number in numbers:
        total += room.above_black(captures[number])
    return total / len(numbers)


class _Template:
    """The light of a colour at full drive, with which its light at other codes is compared.

    light : (camera pixels, 3). Light above black.
    tells : whether any camera pixel is well lit and not saturated.
    noise : standard deviation of the share measured in one capture of full drive.
    """

    def __init__(self, room: Reference, light: FloatArray) -> None:
        lit = (light >= WELL_LIT * room.noise.dark) & (light > 0) & ~room.saturated.reshape(-1, 1)
        variance = np.maximum(room.noise.sigma(light) ** 2, (EXACT * light.max()) ** 2)
        self._weights = np.divide(light, variance, out=np.zeros_like(light), where=lit)
        self._whole = float(np.vdot(self._weights, light))
        self.tells = self._whole > 0
        self.noise = float(np.sqrt((1 + 1 / REPEATS) / self._whole)) if self.tells else 0.0

    def share(self, light: FloatArray) -> float:
        """Returns the share of the template in `light`, by least squares; 0 if the template is not usable."""
        return float(np.vdot(self._weights, light)) / self._whole if self.tells else 0.0


class Primaries:
    """Decomposes light into primaries by least squares, weighted by the noise, where white is well lit."""

    def __init__(self, room: Reference, primaries: Sequence[FloatArray]) -> None:
        lit = (room.light >= WELL_LIT * room.noise.dark) & (room.light > 0) & ~room.saturated.reshape(-1, 1)
        variance = np.maximum(room.noise.sigma(room.light) ** 2, (EXACT * room.light.max()) ** 2)
        self._weighted = np.stack([np.divide(each, variance, out=np.zeros_like(each), where=lit) for each in primaries])
        self._squares = np.einsum("lik,mik->lm", self._weighted, np.stack(primaries))

    def shares(self, light: FloatArray) -> FloatArray:
        """Returns the share of each full primary in `light`, (3,)."""
        sums = np.einsum("lik,ik->l", self._weighted, light)
        return np.asarray(np.linalg.lstsq(self._squares, sums, rcond=UNSEEN)[0])


def crosstalk(primaries: FloatArray, room: Reference) -> float:
    """Returns the crosstalk, averaged over the camera's channels; primaries is (3, camera pixels, 3)."""
    seen = np.maximum(primaries[:, ~room.saturated.ravel()].sum(axis=1), 0)  # (primary, channel)
    whole = seen.sum(axis=0)
    lit = whole > 0
    return float(np.mean(1 - np.diag(seen)[lit] / whole[lit])) if lit.any() else 0.0

"""A projector's response from measured light at known code values (thesis 2.2: intensity transfer function).

The response differs between channels but not over the picture (Raij, Gill, Majumder, Towles and Fuchs 2003), so one
table per channel is enough. Light at code 0 is the black level, which belongs to the ambient term of c = T p + e and
not to the response.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.optimize import isotonic_regression

from counterlight.arrays import FloatArray
from counterlight.errors import InputError
from counterlight.response import Response
from counterlight.tools.hdr.camera_response import NODES, table_response

LEAST_LEVELS = 5
FOLLOWED = 0.01, 0.99  # readings between these shares of white determine the exponent; darker readings are noise
EXPONENTS = 0.4, 4.0


@dataclass(frozen=True)
class ProjectorResponse:
    """A fitted response.

    response : a table of light above black per code value, 0 to 1.
    black_level : (channels,). Light at code 0 as a fraction of light at full code.
    pooled : largest change, as a fraction of white, that made the readings monotone.
    gammas : (channels,). Closest exponents.
    """

    response: Response
    black_level: tuple[float, ...]
    pooled: float
    gammas: tuple[float, ...]

    def __str__(self) -> str:
        blacks = ", ".join(f"{level:.2%}" for level in self.black_level)
        return f"black level {blacks} of white, readings moved by at most {self.pooled:.2%} of white to make them rise"


def fit_projector_response(
    levels: FloatArray, readings: FloatArray, counts: FloatArray | None = None
) -> ProjectorResponse:
    """Fit a rising curve per channel: (L(v) − L(0)) / (L(1) − L(0)).

    Readings are pooled where noise makes them fall (isotonic regression, the closest rising sequence). Their γ-th roots
    are joined by monotone cubics (Fritsch and Carlson 1980), where γ is the curve's median exponent: near black, where
    a curve is steep, its root is straight. The curve need not be a gamma curve or a polynomial.

    levels : (readings,). Code values 0 to 1, including 0 and 1, in any order; readings of equal levels are averaged.
    readings : (readings, 1 or 3). Linear light.
    counts : (readings,). Number of measurements behind each reading; None for one each.

    Raises InputError for fewer than five levels, for a missing black or white, and for white no brighter than black.
    """
    weights = np.ones(len(levels)) if counts is None else counts
    codes, place = np.unique(levels, return_inverse=True)
    _check_levels(codes)
    mass = np.bincount(place, weights).astype(np.float64)
    light = np.stack([np.bincount(place, weights * column) / mass for column in readings.T], axis=1)
    black, white = light[0], light[-1]
    if not (np.isfinite(light).all() and np.all(white > black)):
        raise InputError("grey ramp: white is no brighter than black; check the order of the levels")
    relative = (light - black) / (white - black)
    rising = np.stack([_rising(column, mass) for column in relative.T], axis=1)
    gammas = [exponent(codes, column) for column in rising.T]
    table = np.stack([_joined(codes, *each) for each in zip(rising.T, gammas, strict=True)], axis=1)
    return ProjectorResponse(
        table_response(table),
        tuple(float(v) for v in black / white),
        float(np.abs(rising - relative).max()),
        tuple(gammas),
    )


def exponent(codes: FloatArray, rising: FloatArray) -> float:
    """Returns the median of log light / log code; 1 if no reading is usable."""
    inner = (codes > 0) & (codes < 1) & (rising > FOLLOWED[0]) & (rising < FOLLOWED[1])
    if not inner.any():
        return 1.0
    return float(np.clip(np.median(np.log(rising[inner]) / np.log(codes[inner])), *EXPONENTS))


def _joined(codes: FloatArray, rising: FloatArray, gamma: float) -> FloatArray:
    """Returns the curve at equally spaced codes, (NODES,)."""
    roots = PchipInterpolator(codes, rising ** (1 / gamma))(np.linspace(0, 1, NODES))
    curve = np.clip(roots, 0, 1) ** gamma
    curve[[0, -1]] = rising[[0, -1]]
    return np.asarray(curve)


def _rising(relative: FloatArray, mass: FloatArray) -> FloatArray:
    rising = np.clip(isotonic_regression(relative, weights=mass).x, 0, 1)
    rising[0], rising[-1] = 0, 1
    return np.asarray(rising)


def _check_levels(codes: FloatArray) -> None:
    if len(codes) < LEAST_LEVELS:
        raise InputError(f"grey ramp: {len(codes)} different levels, expected at least {LEAST_LEVELS}; measure more")
    if codes[0] != 0 or codes[-1] != 1:
        raise InputError(
            f"grey ramp: levels {codes[0] * 255:g} to {codes[-1] * 255:g} of 255, expected 0 to 255; measure black and "
            "white, too"
        )

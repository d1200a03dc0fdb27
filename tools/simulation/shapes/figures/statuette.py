"""The bust of a youth with curly hair, on a foot: a union of ellipsoids; small bumps and hollows model the face.

The rectangle is 1 wide and 1.4 high, x from −0.5 to 0.5, y from 0 to 1.4.
"""

import numpy as np

from counterlight.arrays import FloatArray

# Centre x, y; half axes across, up and in depth; depth of the centre.
BODY = (
    (0.0, 0.30, 0.42, 0.36, 0.22, 0.0),
    (0.0, 0.62, 0.115, 0.26, 0.15, 0.05),
    (0.25, 0.42, 0.19, 0.17, 0.16, 0.02),
    (-0.25, 0.42, 0.19, 0.17, 0.16, 0.02),
)
FACE = ((0.0, 0.96, 0.178, 0.25, 0.21, 0.14),)
HAIR = (
    (0.0, 1.07, 0.222, 0.195, 0.23, 0.14),
    (0.17, 0.97, 0.075, 0.13, 0.12, 0.12),
    (-0.17, 0.97, 0.075, 0.13, 0.12, 0.12),
)
SOFTNESS = 12  # exponent of the seams between ellipsoids; larger exponents give sharper seams
CURL = 0.062  # distance between curls
FACE_RISE = 0.96 - 1.00  # the positions of the bumps below are for a head that is 0.04 higher
# x, y; spreads across and up; height, negative for hollows. MIDDLE lies on the axis, SIDES on both sides of it.
MIDDLE = (
    (0.0, 0.975, 0.022, 0.055, 0.040),  # ridge of the nose
    (0.0, 0.925, 0.032, 0.020, 0.045),  # tip of the nose
    (0.0, 0.862, 0.050, 0.011, 0.020),  # upper lip
    (0.0, 0.838, 0.040, 0.011, 0.020),  # lower lip
    (0.0, 0.850, 0.055, 0.004, -0.018),  # mouth
    (0.0, 0.782, 0.040, 0.028, 0.028),  # chin
    (0.0, 0.570, 0.020, 0.020, -0.030),  # hollow of the throat
    (0.0, 0.370, 0.015, 0.120, -0.018),  # breastbone
)
SIDES = (
    (0.076, 1.010, 0.036, 0.022, -0.050),  # eye socket
    (0.076, 1.006, 0.022, 0.012, 0.026),  # eyeball
    (0.078, 1.052, 0.046, 0.011, 0.020),  # brow
    (0.110, 0.935, 0.040, 0.040, 0.016),  # cheekbone
    (0.026, 0.918, 0.014, 0.014, 0.016),  # nostril
    (0.150, 0.380, 0.110, 0.090, 0.040),  # chest
    (0.140, 0.575, 0.110, 0.014, 0.018),  # collarbone
    (0.045, 0.680, 0.022, 0.100, 0.016),  # sinew of the neck
)
FOOT = (0.13, 0.10)  # half width, height


def heights(u: FloatArray, v: FloatArray) -> FloatArray:
    """Returns height over the base at u, v in 0..1: 0 around the figure, at most 1."""
    x, y = u - 0.5, 1.4 * v
    bust_end = np.hypot(x / 0.40, (y - 0.52) / 0.42) < 1  # the bust ends in a curve
    body = np.where(bust_end | (y > 0.5), _union(x, y, BODY), 0)
    figure = _softly(body, _softly(_union(x, y, FACE), _hair(x, y)))
    face_y = y - FACE_RISE
    modelled = sum(_bump(x, face_y, bump) for bump in MIDDLE) + sum(_bump(np.abs(x), face_y, bump) for bump in SIDES)
    figure = np.where(figure > 0.05, np.maximum(figure + modelled, 0.05), 0)
    foot = np.where((np.abs(x) < FOOT[0]) & (y < FOOT[1]), 0.8 * np.sqrt(np.maximum(FOOT[0] ** 2 - x**2, 0)) + 0.06, 0)
    return np.asarray(np.maximum(figure, foot) / 0.5)


def _hair(x: FloatArray, y: FloatArray) -> FloatArray:
    """Returns a cap of curls that rises gradually from the hairline."""
    row = np.round(y / (0.87 * CURL))
    column = np.round(x / CURL - 0.5 * (row % 2)) + 0.5 * (row % 2)
    ring = np.hypot(x - column * CURL, y - row * 0.87 * CURL) / CURL
    turn = np.arctan2(y - row * 0.87 * CURL, x - column * CURL)
    curls = 0.016 * np.cos(2 * np.pi * (1.6 * ring + turn / (2 * np.pi))) - 0.05 * ring**2
    hairline = np.maximum(y - (1.075 - 2.2 * x**2), (np.abs(x) - 0.145) - 0.3 * np.maximum(0, 0.9 - y))
    grown = np.clip(0.5 + hairline / 0.05, 0, 1) ** 0.5
    cap = _union(x, y, HAIR)
    return np.where(cap > 0, (cap + curls) * grown, 0)


def _union(x: FloatArray, y: FloatArray, ellipsoids: tuple[tuple[float, ...], ...]) -> FloatArray:
    """Returns the front of ellipsoids; 0 outside them."""
    front = np.zeros_like(x)
    for centre_x, centre_y, across, up, deep, depth in ellipsoids:
        inside = 1 - ((x - centre_x) / across) ** 2 - ((y - centre_y) / up) ** 2
        front = _softly(front, np.where(inside > 0, depth + deep * np.sqrt(np.maximum(inside, 0)), 0))
    return front


def _softly(a: FloatArray, b: FloatArray) -> FloatArray:
    """Returns the larger of two heights, with a soft seam."""
    return np.asarray((np.maximum(a, 0) ** SOFTNESS + np.maximum(b, 0) ** SOFTNESS) ** (1 / SOFTNESS))


def _bump(x: FloatArray, y: FloatArray, bump: tuple[float, ...]) -> FloatArray:
    at_x, at_y, across, up, height = bump
    return np.asarray(height * np.exp(-(((x - at_x) / across) ** 2) - ((y - at_y) / up) ** 2))

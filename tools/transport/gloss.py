"""Finds projector pixels whose light the camera sees by gloss, where another projector lights the same place.

Paint reflects the light of all projectors alike, so the ratio of two projectors' floodlights is independent of paint
and changes slowly over a surface. A glossy highlight of one projector is a bump on this ratio (thesis 4.3.2; Park et
al. 2006). A viewer at another place does not see the highlight. Light that was omitted because of the highlight is
missing there.
"""

import numpy as np

from counterlight.arrays import BoolArray, FloatArray, IntArray
from counterlight.calibration import Calibration
from counterlight.tools.transport.transport import Transport, luminance

# smallest bump: relative, and in multiples of the usual deviation; smaller ones are the room's shape
BUMP, USUAL = 0.1, 3.0
BESIDE = 0.25  # share of a projector's median light; darker places are its shadow
FEWEST, MOST = 64, 20000  # camera pixels for the fit of a surface
ROUNDS, TUKEY = 30, 4.0
TINY = np.finfo(np.float64).tiny


def glossy(transport: Transport, calibration: Calibration, owner: IntArray) -> FloatArray:
    """Return the share of each projector pixel's light that cameras see as a highlight, (projector pixels,), 0 to 1.

    owner : (projector height, projector width). Number of each pixel's projector from 0; -1 for none.

    Returns 0 everywhere for one projector.
    """
    numbers, near = range(len(calibration.regions)), transport.near
    lights = np.stack([_floodlight(transport, owner.ravel() == each) for each in numbers])
    lights = lights.reshape(len(numbers), *calibration.camera.shape)
    found, ones = np.zeros(transport.shape[1]), np.ones((transport.shape[0], 3))
    sent = np.maximum(luminance(near.apply_transpose(ones)), TINY)
    for each in numbers:
        others = np.delete(lights, each, axis=0).sum(axis=0)
        shares = np.zeros(calibration.camera.shape)
        for view in calibration.views:
            shares[view] = _highlights(lights[each][view], others[view])
        seen = luminance(near.apply_transpose(shares.reshape(-1, 1) * ones))
        found = np.where(owner.ravel() == each, seen / sent, found)
    return found


def _floodlight(transport: Transport, pixels: BoolArray) -> FloatArray:
    """Return near light of some projector pixels, luminance, (camera pixels,)."""
    return luminance(transport.near.apply(np.repeat(pixels[:, None].astype(np.float64), 3, axis=1)))


def _highlights(light: FloatArray, others: FloatArray) -> FloatArray:
    """Return the share of a projector's light above the usual ratio to the others' light, per camera pixel."""
    lit = [each > BESIDE * np.median(each[each > 0]) if each.any() else each > 0 for each in (light, others)]
    both = lit[0] & lit[1]
    if np.count_nonzero(both) < FEWEST:
        return np.zeros(light.shape)
    ratio = np.log(np.where(both, light, 1) / np.where(both, others, 1))
    above, usual = _above_surface(ratio, both)
    share = np.where(both & (above > max(np.log1p(BUMP), USUAL * usual)), 1 - np.exp(-above), 0)
    return np.asarray(share)


def _above_surface(values: FloatArray, known: BoolArray) -> tuple[FloatArray, float]:
    """Return distances above the quadratic surface that fits most known values, and their median absolute deviation.

    Uses reweighted least squares with Tukey's biweight.
    """
    y, x = (2 * each / max(each.max(), 1) - 1 for each in np.mgrid[: values.shape[0], : values.shape[1]])
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)
    at = np.flatnonzero(known)
    at = at[:: -(-at.size // MOST)]
    A, b = terms.reshape(-1, 6)[at], values.ravel()[at]
    weights, usual = np.ones(at.size), 0.0
    found: FloatArray = np.zeros(6)
    for _ in range(ROUNDS):
        found = np.asarray(np.linalg.lstsq(A * weights[:, None], b * weights, rcond=None)[0], np.float64)
        off = np.abs(b - A @ found)
        usual = float(np.median(off))
        weights = np.clip(1 - (off / max(TUKEY * usual, TINY)) ** 2, 0, None)
    return np.where(known, values - terms @ found, 0), usual

"""The target that a picture sets in a room, pixel by pixel.

A picture x is stated in the projector's primaries, as on a white screen. The picture's target is white · M₀ x at a
camera pixel, and darkness where no picture stands. M₀ is what the camera sees of the primaries there. The target is as
much of white · M₀ x as the pixel can show by itself, by some drive of the three floodlights. Beyond the calibrated
view, the target is a range: from darkness to the light of the uncompensated picture there. No mask is read.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tests.rig.lattice import FINE
from tests.rig.pictures import Picture
from tests.rig.rays import FloatArray
from tests.rig.rig import Rig
from tests.rig.view import View

BoolArray = NDArray[np.bool_]
Codes = NDArray[np.uint8]

LIT = 0.01  # light of a lit pixel, as a share of the 99th percentile of direct light
GLIMMER = 0.001  # share of the 99th percentile of all light; brighter pixels measure light outside the picture
BRIGHT = 99.0
NEARBY = 8  # audience's pixels per side: tolerance for the position of the uncompensated picture's light
PIXEL_STEPS = 100  # number of steps for the three unknowns of a pixel


@dataclass(frozen=True)
class Asked:
    """The target, a range from least to most.

    least, most : (pixels, 3), radiance.
    counted : (pixels,). Pixels in the calibrated view that the projector lights directly.
    white : radiance of a white picture.
    """

    least: FloatArray
    most: FloatArray
    counted: BoolArray
    white: float

    def error(self, seen: FloatArray) -> FloatArray:
        """Returns the signed distance from the range: (pixels, 3)."""
        return np.asarray(seen - np.clip(seen, self.least, self.most))


@dataclass(frozen=True)
class Question:
    """The targets of a picture in a room, for the calibrated camera's pixels and the audience's pixels.

    beyond : (audience pixels,). Lit, and beyond the calibrated view.
    beside : (audience height, audience width). Lit, and outside the picture.
    """

    near: Asked
    wide: Asked
    beyond: BoolArray
    beside: BoolArray


class Limits:
    """The light that each pixel of one camera can show.

    dark : (pixels, 3). Under the projector's black.
    flood : (pixels, camera channel, primary).
    lit : (pixels,).
    """

    def __init__(self, rig: Rig, view: View, dark: FloatArray) -> None:
        projector = rig.devices.projector
        span = projector.brightest - projector.lamp * projector.black
        primaries = [np.tile(row, (rig.raster[0] * rig.raster[1], 1)) for row in span * np.eye(3)]
        self.dark = dark
        self.flood = rig.exposure * np.stack([view.rise(each) for each in primaries], axis=2)
        self.lit = _above(view.direct_rise(), LIT)
        self._of_white = rig.light.of_white()

    def of(self, wanted: FloatArray, white: float) -> FloatArray:
        """Returns the nearest reachable light, (pixels, 3), to a linear picture (height, width, 3) over the view."""
        return reachable(white * wanted.reshape(-1, 3) @ self._of_white.T, self.dark, self.flood)

    @property
    def glimmer(self) -> BoolArray:
        return _above(self.flood.sum(axis=2), GLIMMER)


class Questions:
    """Targets of pictures for one rig in its present state."""

    def __init__(self, rig: Rig) -> None:
        black = np.zeros((*rig.raster, 3), np.uint8)
        self._rig = rig
        self.near = Limits(rig, rig.calibrated, rig.seen(black))
        self.wide = Limits(rig, rig.audience, rig.seen_by_audience(black))
        self._glimmer = self.wide.glimmer

    def of(self, picture: Picture, white: float, plain: Codes) -> Question:
        """Returns the targets of a picture.

        white : radiance of a white picture.
        plain : codes of the uncompensated picture.
        """
        wanted, inside = picture.placed(self._rig.camera)
        audience = self._rig.room.lattice.audience
        stands, view = (_framed(each, audience).ravel() > 0 for each in (inside, np.ones_like(inside)))
        beyond = self._glimmer & ~view
        thrown = self._rig.seen_by_audience(plain).reshape(*audience, 3)
        nearby = ndimage.maximum_filter(thrown, (NEARBY, NEARBY, 1)).reshape(-1, 3)
        target = self.wide.of(_framed(wanted, audience), white)
        least = np.where(beyond[:, None], self.wide.dark, target)
        most = np.where(beyond[:, None], np.maximum(nearby, self.wide.dark), target)
        counted = self.wide.lit & view
        beside = self._glimmer & ~(counted & stands)
        target = self.near.of(wanted, white)
        near = Asked(target, target, self.near.lit, white)
        return Question(near, Asked(least, most, counted, white), beyond, beside.reshape(audience))


def reachable(wanted: FloatArray, dark: FloatArray, flood: FloatArray) -> FloatArray:
    """Returns the light nearest to `wanted` that each pixel can show by itself: dark + F q, 0 ≤ q ≤ 1.

    wanted, dark : (pixels, 3).
    flood : F, (pixels, camera channel, primary).
    """
    light = wanted - dark
    squares = np.einsum("nki,nkj->nij", flood, flood)
    step = 1 / np.maximum(np.trace(squares, axis1=1, axis2=2), 1e-30)[:, None]
    asked = np.einsum("nki,nk->ni", flood, light)
    q = np.zeros_like(light)
    y, momentum = q, 1.0
    for _ in range(PIXEL_STEPS):
        following = np.clip(y + step * (asked - np.einsum("nij,nj->ni", squares, y)), 0, 1)
        grown = (1 + np.sqrt(1 + 4 * momentum**2)) / 2
        y = following + (momentum - 1) / grown * (following - q)
        q, momentum = following, grown
    return np.asarray(dark + np.einsum("nki,ni->nk", flood, q))


def _above(rise: FloatArray, share: float) -> BoolArray:
    light = rise.mean(axis=1)
    return np.asarray(light > share * np.percentile(light, BRIGHT))


def _framed(picture: FloatArray | BoolArray, size: tuple[int, int]) -> FloatArray:
    """Returns the calibrated view's picture in the middle of the audience's wider view; each pixel becomes a block."""
    finer = np.asarray(picture, np.float64).repeat(FINE, axis=0).repeat(FINE, axis=1)
    margins = [((whole - part) // 2, (whole - part) // 2) for whole, part in zip(size, finer.shape, strict=False)]
    return np.pad(finer, margins + [(0, 0)] * (finer.ndim - 2))

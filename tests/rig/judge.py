"""The judge's figures: error over all lit pixels, colour, and light outside the picture."""

from dataclasses import dataclass

import colour
import numpy as np
from scipy import ndimage

from tests.rig.asked import BRIGHT, Asked, BoolArray, Codes, Question, Questions
from tests.rig.lattice import FINE
from tests.rig.pictures import Picture
from tests.rig.rays import FloatArray
from tests.rig.rig import Rig

BLUR = 2.0  # σ of the blur of `Figures.smooth`, camera pixels
BORDER = 4  # width of the border, in camera pixels
BLOCK = 8  # audience's pixels per side, for flares
SRGB_WHITE = 0.9505, 1.0, 1.089


@dataclass(frozen=True)
class Figures:
    """Quality in dB against white, and mean CIEDE2000.

    psnr : over all lit pixels of the calibrated view.
    inside : over lit pixels at least four pixels inside the lit area.
    everywhere : also beyond the view.
    smooth : error blurred by two pixels.
    """

    psnr: float
    inside: float
    everywhere: float
    smooth: float
    delta_e: float


@dataclass(frozen=True)
class Outside:
    """Light outside the picture, shares of white.

    mean : mean of all outside light.
    flare : 99th percentile of the brightest channel of small blocks.
    """

    mean: float
    flare: float


class Judge:
    """Judges one rig in its present state."""

    def __init__(self, rig: Rig) -> None:
        self.rig, self._questions, self._to_xyz = rig, Questions(rig), rig.light.to_xyz()

    def asks(self, picture: Picture, white: float, plain: Codes) -> Question:
        """Returns the targets of a picture.

        white : radiance of a white picture.
        plain : codes of the uncompensated picture.
        """
        return self._questions.of(picture, white, plain)

    def figures(self, question: Question, codes: Codes) -> Figures:
        """Returns the figures of code values (height, width, 3), seen without noise."""
        asked, seen = question.near, self.rig.seen(codes)
        error, within = asked.error(seen), _within(asked.counted, self.rig.camera)
        beyond = question.wide.error(self.rig.seen_by_audience(codes))[question.beyond]
        lit, share = error[asked.counted], 1 / FINE**2  # an audience's pixel covers this share of a calibrated pixel
        everywhere = np.concatenate([lit, beyond])
        weights = np.repeat([1, share], [len(lit), len(beyond)])
        smooth = _blurred(error, asked.counted, self.rig.camera)
        return Figures(
            decibels(lit, asked.white),
            decibels(error[within], asked.white),
            decibels(everywhere, asked.white, weights),
            decibels(smooth[asked.counted], asked.white),
            self._delta_e(asked, seen),
        )

    def outside(self, question: Question, codes: Codes) -> Outside:
        """Returns the light that the audience sees outside the picture."""
        beside, dark = question.beside, self._questions.wide.dark
        light = (self.rig.seen_by_audience(codes) - dark).reshape(*beside.shape, 3) / question.wide.white
        count = _blocks(beside[..., None])
        blocks = (_blocks(np.where(beside[..., None], light, 0)) / np.maximum(count, 1)).max(axis=2)
        small = blocks[count[..., 0] >= BLOCK * BLOCK // 2]
        return Outside(float(light[beside].mean()), float(np.percentile(small, BRIGHT)))

    def srgb(self, seen: FloatArray, white: float) -> Codes:
        """Returns radiance (…, 3) as a picture for people; white's own colour is shown as white."""
        xyz = np.clip(seen / white, 0, None) @ self._to_xyz.T
        adapted = colour.chromatic_adaptation(xyz, self._to_xyz.sum(axis=1), SRGB_WHITE)
        return np.rint(255 * np.clip(colour.XYZ_to_sRGB(adapted), 0, 1)).astype(np.uint8)

    def _delta_e(self, asked: Asked, seen: FloatArray) -> float:
        white_xy = colour.XYZ_to_xy(self._to_xyz.sum(axis=1))
        wanted, found = (
            colour.XYZ_to_Lab(np.clip(light[asked.counted] / asked.white, 0, None) @ self._to_xyz.T, white_xy)
            for light in (seen - asked.error(seen), seen)
        )
        return float(np.mean(colour.delta_E(wanted, found, method="CIE 2000")))


def decibels(error: FloatArray, white: float, weights: FloatArray | None = None) -> float:
    """Returns 10 log₁₀(white² / mean error²).

    error : (pixels, 3).
    weights : (pixels,).
    """
    mean = float(np.average(np.mean(error**2, axis=1), weights=weights))
    return float(10 * np.log10(white**2 / max(mean, 1e-30)))


def _within(lit: BoolArray, size: tuple[int, int]) -> BoolArray:
    """Returns the lit pixels at least BORDER from unlit pixels and from the view's edges, (pixels,).

    size : (height, width).
    """
    return ndimage.binary_erosion(lit.reshape(size), np.ones((3, 3)), iterations=BORDER).ravel()


def _blurred(error: FloatArray, counted: BoolArray, size: tuple[int, int]) -> FloatArray:
    """Blur over counted pixels alone, so that other pixels do not leak in."""
    weight = ndimage.gaussian_filter(counted.reshape(size).astype(np.float64), BLUR)
    spread = ndimage.gaussian_filter((counted[:, None] * error).reshape(*size, 3), (BLUR, BLUR, 0))
    return np.asarray((spread / np.maximum(weight, 1e-3)[..., None]).reshape(-1, 3))


def _blocks(picture: FloatArray | BoolArray) -> FloatArray:
    """Returns sums over whole blocks of (height, width, channels)."""
    height, width = (n // BLOCK for n in picture.shape[:2])
    cut = picture[: height * BLOCK, : width * BLOCK].astype(np.float64)
    return np.asarray(cut.reshape(height, BLOCK, width, BLOCK, -1).sum(axis=(1, 3)))

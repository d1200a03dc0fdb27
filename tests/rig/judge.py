"""What an eye makes of it: error over all that is lit, colour, and light where none belongs."""

from dataclasses import dataclass

import colour
import numpy as np
from scipy import ndimage

from tests.rig.asked import BRIGHT, Asked, BoolArray, Codes, Question, Questions
from tests.rig.lattice import FINE
from tests.rig.pictures import Picture
from tests.rig.rays import FloatArray
from tests.rig.rig import Rig

BLUR = 2.0  # σ in camera pixels
BORDER = 4  # camera pixels
BLOCK = 8  # audience's pixels a side, for flares
SRGB_WHITE = 0.9505, 1.0, 1.089


@dataclass(frozen=True)
class Figures:
    """Of what counts: dB against white, and mean CIEDE2000.

    psnr : over all lit pixels of the calibrated view.  inside : over those at least four pixels within the lit area.
    everywhere : beyond the view, too.  smooth : of the error blurred by two pixels.
    """

    psnr: float
    inside: float
    everywhere: float
    smooth: float
    delta_e: float


@dataclass(frozen=True)
class Outside:
    """Light outside the picture, shares of white.

    mean : of all of it.  flare : 99th percentile of the brightest channel of small blocks.
    """

    mean: float
    flare: float


class Judge:
    """Looks at one rig as it stands now."""

    def __init__(self, rig: Rig) -> None:
        self.rig, self._questions, self._to_xyz = rig, Questions(rig), rig.light.to_xyz()

    def asks(self, picture: Picture, white: float, plain: Codes) -> Question:
        """white : radiance of a white picture.  plain : the picture as it is projected without compensation."""
        return self._questions.of(picture, white, plain)

    def figures(self, question: Question, codes: Codes) -> Figures:
        """Of what is seen of code values without noise: (height, width, 3)."""
        asked, seen = question.near, self.rig.seen(codes)
        error, within = asked.error(seen), _within(asked.counted, self.rig.camera)
        beyond = question.wide.error(self.rig.seen_by_audience(codes))[question.beyond]
        lit, share = error[asked.counted], 1 / FINE**2  # of a calibrated pixel that an audience's pixel is
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
        """Of what the audience sees where the picture is not."""
        beside, dark = question.beside, self._questions.wide.dark
        light = (self.rig.seen_by_audience(codes) - dark).reshape(*beside.shape, 3) / question.wide.white
        count = _blocks(beside[..., None])
        blocks = (_blocks(np.where(beside[..., None], light, 0)) / np.maximum(count, 1)).max(axis=2)
        small = blocks[count[..., 0] >= BLOCK * BLOCK // 2]
        return Outside(float(light[beside].mean()), float(np.percentile(small, BRIGHT)))

    def srgb(self, seen: FloatArray, white: float) -> Codes:
        """(…, 3) radiance as a picture for people: white's own colour is white."""
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
    """10 log₁₀(white² / mean error²): (pixels, 3), weights (pixels,)."""
    mean = float(np.average(np.mean(error**2, axis=1), weights=weights))
    return float(10 * np.log10(white**2 / max(mean, 1e-30)))


def _within(lit: BoolArray, size: tuple[int, int]) -> BoolArray:
    """Lit pixels at least BORDER from any other and from the view's edges, (pixels,).  size : (height, width)."""
    return ndimage.binary_erosion(lit.reshape(size), np.ones((3, 3)), iterations=BORDER).ravel()


def _blurred(error: FloatArray, counted: BoolArray, size: tuple[int, int]) -> FloatArray:
    """Over what counts alone: its borders are not blurred into."""
    weight = ndimage.gaussian_filter(counted.reshape(size).astype(np.float64), BLUR)
    spread = ndimage.gaussian_filter((counted[:, None] * error).reshape(*size, 3), (BLUR, BLUR, 0))
    return np.asarray((spread / np.maximum(weight, 1e-3)[..., None]).reshape(-1, 3))


def _blocks(picture: FloatArray | BoolArray) -> FloatArray:
    """Sums over whole blocks of (height, width, channels)."""
    height, width = (n // BLOCK for n in picture.shape[:2])
    cut = picture[: height * BLOCK, : width * BLOCK].astype(np.float64)
    return np.asarray(cut.reshape(height, BLOCK, width, BLOCK, -1).sum(axis=(1, 3)))

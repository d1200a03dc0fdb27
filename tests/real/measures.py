"""The measures of the literature: PSNR, RMSE, SSIM and ΔE2000."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from skimage.color import deltaE_ciede2000, rgb2lab
from skimage.metrics import structural_similarity

from counterlight.arrays import BoolArray

Pictures = NDArray[np.floating]


@dataclass(frozen=True)
class Measures:
    """Means over pictures of sRGB code values, 0 to 1."""

    psnr: float
    rmse: float
    ssim: float
    delta_e: float

    def __str__(self) -> str:
        return f"{self.psnr:.2f} dB | {self.rmse:.4f} | {self.ssim:.3f} | {self.delta_e:.2f}"


def psnr(found: Pictures, true: Pictures, counted: BoolArray) -> float:
    """Return the PSNR over all pictures together, in counted pixels, for values from 0 to 1."""
    return float(-10 * np.log10(np.mean((np.clip(found, 0, 1) - true)[:, counted] ** 2)))


def srgb(light: Pictures) -> Pictures:
    light = np.clip(light, 0, 1)
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


def measured(found: Pictures, true: Pictures, counted: BoolArray) -> Measures:
    """Measure code values (pictures, height, width, 3)."""
    found = np.clip(found, 0, 1)
    both = list(zip(found, true, strict=True))
    squares = [np.mean((a - b)[counted] ** 2) for a, b in both]
    similar = [
        structural_similarity(a, b, channel_axis=-1, data_range=1.0, full=True)[1][counted].mean() for a, b in both
    ]
    colours = [deltaE_ciede2000(rgb2lab(a), rgb2lab(b))[counted].mean() for a, b in both]
    mean = float(np.mean(squares))
    return Measures(-10 * np.log10(mean), float(np.sqrt(mean)), float(np.mean(similar)), float(np.mean(colours)))

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
    """Measures of sRGB code values, 0 to 1.

    rmse : root of the mean squared distance of two colours, √3 times the error per channel.
    ssim : with a Gaussian window of 1.5 pixels (Wang 2004).
    """

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
        structural_similarity(
            *pair,
            channel_axis=-1,
            data_range=1.0,
            gaussian_weights=True,
            sigma=1.5,
            use_sample_covariance=False,
            full=True,
        )[1][counted].mean()
        for pair in both
    ]
    colours = [deltaE_ciede2000(rgb2lab(a), rgb2lab(b))[counted].mean() for a, b in both]
    mean = float(np.mean(squares))
    return Measures(-10 * np.log10(mean), float(np.sqrt(3 * mean)), float(np.mean(similar)), float(np.mean(colours)))

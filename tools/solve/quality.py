"""The quality of a picture for the camera: RMSE, PSNR, SSIM and CIEDE2000 over the lit camera pixels.

All figures compare the predicted camera picture, c = T p + e with the undecomposed T, to the desired radiance, both
divided by the room's white level. RMSE and PSNR use linear radiance. SSIM and CIEDE2000, which model human vision,
interpret 0..1 as linear light of sRGB's primaries (BT.709, D65), clipped to 0..1:

- SSIM: Wang et al. (2004) with their Gaussian window (σ = 1.5) on sRGB code values 0..1, mean over channels and pixels;
  elsewhere, both pictures are the desired one.
- CIEDE2000: Sharma et al. (2005), kL = kC = kH = 1, in CIE Lab under D65 (2° observer), mean over pixels.
"""

import warnings
from dataclasses import dataclass
from functools import cache
from types import ModuleType

import numpy as np
from numpy.typing import NDArray
from skimage.metrics import structural_similarity

from counterlight.arrays import FloatArray
from counterlight.pipeline.content import psnr

SSIM_WINDOW = 11  # pixels within the reach of σ = 1.5, cut at 3.5 σ


@dataclass(frozen=True)
class Quality:
    """Figures of a picture.

    rmse : relative to white.
    psnr : in dB, peak white.
    ssim : NaN for views of less than 11 pixels a side.
    ciede2000 : mean colour difference.
    """

    rmse: float
    psnr: float
    ssim: float
    ciede2000: float


def measure(desired: FloatArray, seen: FloatArray, lit: NDArray[np.bool_], white: float) -> Quality:
    """Compare radiance, (camera height, camera width, 3), over the lit pixels, (camera height, camera width)."""
    wanted, found = desired / white, np.where(lit[..., None], seen, desired) / white
    mean_square = float(np.mean((found - wanted)[lit] ** 2))
    codes = [_srgb(picture) for picture in (wanted, found)]
    return Quality(
        rmse=float(np.sqrt(mean_square)),
        psnr=psnr(mean_square),
        ssim=_ssim(codes[0], codes[1], lit),
        ciede2000=float(np.mean(_colour().delta_E(_lab(wanted[lit]), _lab(found[lit]), method="CIE 2000"))),
    )


def _ssim(wanted: FloatArray, found: FloatArray, lit: NDArray[np.bool_]) -> float:
    if min(lit.shape) < SSIM_WINDOW:
        return float("nan")
    _, similar = structural_similarity(  # type: ignore[no-untyped-call]
        wanted,
        found,
        data_range=1.0,
        channel_axis=2,
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
        full=True,
    )
    return float(np.mean(similar[lit]))


def _srgb(linear: FloatArray) -> FloatArray:
    return np.asarray(_colour().cctf_encoding(np.clip(linear, 0, 1), function="sRGB"))


def _lab(linear: FloatArray) -> FloatArray:
    """Convert linear sRGB (n, 3) to CIE Lab."""
    space = _colour().RGB_COLOURSPACES["sRGB"]
    xyz = np.clip(linear, 0, 1) @ space.matrix_RGB_to_XYZ.T
    return np.asarray(_colour().XYZ_to_Lab(xyz, space.whitepoint))


@cache
def _colour() -> ModuleType:
    """Import colour-science on first use: its import takes a second, which commands without figures save."""
    with warnings.catch_warnings(record=True):  # the import warns about missing matplotlib, and resets warning filters
        warnings.simplefilter("ignore")
        import colour
    return colour

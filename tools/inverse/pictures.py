"""A few pictures that represent usual content. λ is chosen by what the clamp does to them."""

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.calibration import Calibration
from counterlight.pipeline.fitting import on_cameras

PICTURES = 3


def typical_pictures(shape: tuple[int, int]) -> list[FloatArray]:
    """Return three grey pictures (height, width), linear, 0..1: like a photograph, like lettering, and a bright ramp.

    They depend on the shape only. The photograph is 1/f noise (Field 1987: natural pictures' amplitude falls as 1/f).
    """
    height, width = shape
    y, x = np.mgrid[:height, :width]
    ramp = (x + 0.5) / width
    stroke = max(2, width // 60)
    letters = ((x // stroke + 2 * (y // (3 * stroke))) % 5 < 2) & (y // (3 * stroke) % 2 == 0)
    return [_noise(shape, 1.0), np.where(letters, 0.9, 0.05), 0.2 + 0.75 * ramp]


def soft_picture(shape: tuple[int, int]) -> FloatArray:
    """Return a picture like a soft photograph, (height, width), linear, 0..1: 1/f² noise, softer than 1/f."""
    return _noise(shape, 2.0)


def pictures_of(calibration: Calibration) -> list[FloatArray]:
    """Return the typical pictures in the camera's view; for several cameras, from their shared screen."""
    grey = typical_pictures(calibration.placed_on)
    return [on_cameras(np.repeat(picture[..., None], 3, axis=2), calibration)[..., 0] for picture in grey]


def _noise(shape: tuple[int, int], slope: float) -> FloatArray:
    """Return noise whose amplitude falls as 1/f^slope."""
    height, width = shape
    frequency = np.hypot(np.fft.fftfreq(height)[:, None] * height, np.fft.rfftfreq(width)[None, :] * width)
    noise = np.fft.rfft2(np.random.default_rng(2006).standard_normal(shape))
    picture = np.fft.irfft2(noise / np.maximum(frequency, 1.0) ** slope, s=shape)
    low, high = np.percentile(picture, [2, 98])
    return np.asarray(
        np.clip((picture - low) / max(high - low, 1e-12), 0, 1) ** 2
    )  # squared: linear light is mostly dark

"""What a viewer changes while a picture plays: mpv's picture controls, what may clip, what is shown instead of it.

mpv's four act on the gamma-coded signal, before it becomes light, with mpv's ranges and meaning (its csputils.c). Of a
code R' = (r, g, b), 0..1, with luma y by the medium's own weights,

    R' ← clamp(k (y + s (R' − y)) + l)^(1/γ),   k = 1 + contrast/100,   s = 1 + saturation/100,
                                                l = brightness/100,     γ = 8^(gamma/100).

mpv leaves the saturation of pictures in RGB alone; here they have BT.709's luma. An OpenEXR picture is radiance, has no
code, and keeps what it asks for; black level and adaptation act on linear light and on every picture.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from counterlight.colour import LUMA_WEIGHTS, Decoding
from counterlight.errors import InputError
from counterlight.frames import PixelFormat
from counterlight.placement import Corners, check_corners
from counterlight.test_cards import CARDS

CONTROL = 100  # brightness, contrast, gamma and saturation go from minus this to this
MOST_FLICKER = 0.95
MOST_BLACK = 0.5  # share of white
LARGEST_GAMMA = 8.0


@dataclass(frozen=True)
class Adjustments:
    """All that can be changed live; as it is made, nothing is.

    brightness, contrast, gamma, saturation : -100..100, as in mpv.
    black_level : share of white, 0..0.5, that black asks for; white stays.
    adapt : percent of the light that may clip (player/content.py); 0 leaves the picture as it is.
    flicker : weight of the previous frame's drive, 0..0.95.
    clipping : colour what clips.
    card : one of counterlight.test_cards.CARDS instead of the picture, uncompensated.
    corners : of the picture in the camera's view; None fits it in.
    Raises InputError for a value out of its range.
    """

    brightness: int = 0
    contrast: int = 0
    gamma: int = 0
    saturation: int = 0
    black_level: float = 0.0
    adapt: float = 0.0
    flicker: float = 0.0
    clipping: bool = False
    card: str | None = None
    corners: Corners | None = None

    def __post_init__(self) -> None:
        for name in ("brightness", "contrast", "gamma", "saturation"):
            _check_range(name, getattr(self, name), -CONTROL, CONTROL)
        _check_range("black_level", self.black_level, 0, MOST_BLACK)
        _check_range("adapt", self.adapt, 0, 100)
        _check_range("flicker", self.flicker, 0, MOST_FLICKER)
        if self.card is not None and self.card not in CARDS:
            raise InputError(f"no test card {self.card!r}; there are {', '.join(CARDS)}")
        if self.corners is not None:
            check_corners(self.corners)


def adjusted_decoding(decoding: Decoding, pixels: PixelFormat, adjustments: Adjustments) -> tuple[Decoding, float]:
    """The decoding with contrast and saturation in its matrix, and the lift of every code (brightness)."""
    kr, kb = LUMA_WEIGHTS.get(pixels.matrix, LUMA_WEIGHTS["bt709"])
    gain, saturation = 1 + adjustments.contrast / CONTROL, 1 + adjustments.saturation / CONTROL
    luma = np.outer(np.ones(3), (kr, 1 - kr - kb, kb))
    matrix = gain * (saturation * np.eye(3) + (1 - saturation) * luma)
    return replace(decoding, to_rgb=matrix @ decoding.to_rgb), adjustments.brightness / CONTROL


def adjusted_transfer(table: NDArray[np.float32], adjustments: Adjustments) -> NDArray[np.float32]:
    """The transfer table with the viewer's gamma in it: light of code^(1/γ)."""
    if not adjustments.gamma:
        return table
    codes = np.linspace(0, 1, table.size)
    exponent = float(LARGEST_GAMMA ** (-adjustments.gamma / CONTROL))
    return np.asarray(np.interp(codes**exponent, codes, table), np.float32)


def _check_range(name: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:  # NaN is refused, too
        raise InputError(f"{name.replace('_', '-')} {value}: expected {low} to {high}")


NEUTRAL = Adjustments()

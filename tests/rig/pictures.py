"""The test pictures: a photograph in wide screen, a portrait that fills the view, and ramps of grey and colour.

The pictures have no detail finer than a projector pixel (1.6 camera pixels). Such detail, which no projector can show,
would dominate every error and hide the rest.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from skimage import data

from tests.rig.rays import FloatArray

Srgb = NDArray[np.uint8]
SOFT = 2.5  # σ, camera pixels
FADE = 0.13  # share of the picture's height over which it fades out


@dataclass(frozen=True)
class Picture:
    """A picture.

    srgb : (height, width, 3), at its size in the camera's view, so that no resampling is needed.
    """

    name: str
    srgb: Srgb

    @property
    def linear(self) -> FloatArray:
        codes = self.srgb / 255.0
        return np.where(codes <= 0.04045, codes / 12.92, ((codes + 0.055) / 1.055) ** 2.4)

    def placed(self, view: tuple[int, int]) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Returns the linear picture in the middle of a view, (height, width, 3), 0 outside, and its mask."""
        height, width = self.srgb.shape[:2]
        top, left = (view[0] - height) // 2, (view[1] - width) // 2
        whole, inside = np.zeros((*view, 3)), np.zeros(view, np.bool_)
        whole[top : top + height, left : left + width] = self.linear
        inside[top : top + height, left : left + width] = True
        return whole, inside

    def write(self, path: Path) -> None:
        assert cv2.imwrite(str(path), np.ascontiguousarray(self.srgb[..., ::-1])), path


def coffee(view: tuple[int, int]) -> Picture:
    """Returns a cup on a wooden table, 16:9, faded out upwards and downwards, where the view must stay dark."""
    whole = data.coffee()
    height = whole.shape[1] * 9 // 16
    top = (whole.shape[0] - height) // 2
    cup = _resized(whole[top : top + height], (round(view[1] * 9 / 16), view[1]))
    rows = (np.arange(len(cup)) + 0.5) / len(cup)
    fade = np.clip(np.minimum(rows, rows[::-1]) / FADE - 1 / 3, 0, 1)[:, None, None]
    return _soft("coffee", np.rint(cup * fade).astype(np.uint8))


def astronaut(view: tuple[int, int]) -> Picture:
    """Returns a face, orange cloth, black and white; as wide as the view."""
    whole = data.astronaut()
    height = round(whole.shape[1] * view[0] / view[1])
    return _soft("astronaut", _resized(whole[:height], view))


def ramps(view: tuple[int, int]) -> Picture:
    """Returns all hues from pale to saturated, darker downwards, over a grey ramp from black to white."""
    height, width = view
    x, y = np.meshgrid(np.linspace(0, 1, width), np.linspace(0, 1, height))
    hue = np.clip(np.abs((6 * x[..., None] + (0, 4, 2)) % 6 - 3) - 1, 0, 1)
    colours = (0.3 + 0.5 * hue) * (0.85 - 0.4 * y[..., None])
    grey = np.repeat(x[..., None], 3, axis=2)
    codes = np.where((y > 0.75)[..., None], grey, colours)
    return _soft("ramps", np.rint(codes * 255).astype(np.uint8))


PICTURES: dict[str, Callable[[tuple[int, int]], Picture]] = {"coffee": coffee, "astronaut": astronaut, "ramps": ramps}


def _soft(name: str, srgb: Srgb) -> Picture:
    return Picture(name, np.asarray(cv2.GaussianBlur(srgb, (0, 0), SOFT, borderType=cv2.BORDER_REPLICATE), np.uint8))


def _resized(picture: Srgb, size: tuple[int, int]) -> Srgb:
    return np.asarray(cv2.resize(picture, size[::-1], interpolation=cv2.INTER_AREA), np.uint8)

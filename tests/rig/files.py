"""Storage of what a camera's sensor saw: a curve, eight bits, perhaps JPEG."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tests.rig.rays import FloatArray

FULL = (1 << 16) - 1  # largest code of the sensor


@dataclass(frozen=True)
class Stored:
    """File format of a camera.

    curve : one of CURVES, or a number as gamma.
    bits : 16, as the sensor gives them, or 8.
    quality : of JPEG with halved colours (4:2:0); 0 for PNG.
    """

    curve: str | float = "linear"
    bits: int = 8
    quality: int = 0

    def codes(self, sensor: NDArray[np.uint16]) -> NDArray[Any]:
        """Returns the codes that a program reads from such a file: (height, width, 3)."""
        light = sensor / FULL
        seen = light ** (1 / self.curve) if isinstance(self.curve, float) else CURVES[self.curve](light)
        if self.bits == 16:
            return np.rint(FULL * seen).astype(np.uint16)
        codes = np.rint(255 * seen).astype(np.uint8)
        return codes if self.quality == 0 else _compressed(codes, self.quality)


def _compressed(codes: NDArray[np.uint8], quality: int) -> NDArray[np.uint8]:
    halved = cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420
    done, content = cv2.imencode(
        ".jpg", np.ascontiguousarray(codes[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, quality, *halved]
    )
    assert done
    decoded = cv2.imdecode(content, cv2.IMREAD_COLOR)
    assert decoded is not None
    return np.asarray(decoded[..., ::-1], np.uint8)


def _srgb(light: FloatArray) -> FloatArray:
    """Apply the sRGB curve (IEC 61966-2-1)."""
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-9) ** (1 / 2.4) - 0.055)


def _contrast(light: FloatArray) -> FloatArray:
    """Apply an S curve: shadows darker, highlights brighter."""
    return light * light * (3 - 2 * light)


CURVES = {
    "linear": lambda light: light,
    "srgb": _srgb,
    "S": _contrast,
    "srgb, then S": lambda light: _contrast(_srgb(light)),
    "weak S": lambda light: 0.6 * light + 0.4 * _contrast(light),
}

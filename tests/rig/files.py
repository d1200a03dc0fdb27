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
    quality : quality of JPEG with halved colours (4:2:0); 0 for PNG.
    smoothing : radius in pixels of a blur that reduces noise, before the curve.
    sharpening : share of the difference from a blur by a pixel that is added, after the curve.
    """

    curve: str | float = "linear"
    bits: int = 8
    quality: int = 0
    smoothing: float = 0.0
    sharpening: float = 0.0

    @property
    def suffix(self) -> str:
        """Suffix of the files."""
        return ".jpg" if self.quality else ".png"

    def codes(self, sensor: NDArray[np.uint16]) -> NDArray[Any]:
        """Returns the codes that a program reads from such a file: (height, width, 3)."""
        if not self.quality:
            return self._developed(sensor)
        decoded = cv2.imdecode(np.frombuffer(self.content(sensor), np.uint8), cv2.IMREAD_COLOR)
        assert decoded is not None
        return np.asarray(decoded[..., ::-1], np.uint8)

    def content(self, sensor: NDArray[np.uint16]) -> bytes:
        """Returns the file of what the sensor saw."""
        options = cv2.IMWRITE_PNG_COMPRESSION, 1
        if self.quality:
            halved = cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420
            options = cv2.IMWRITE_JPEG_QUALITY, self.quality, *halved
        done, content = cv2.imencode(self.suffix, np.ascontiguousarray(self._developed(sensor)[..., ::-1]), options)
        assert done
        return bytes(content)

    def _developed(self, sensor: NDArray[np.uint16]) -> NDArray[Any]:
        """Returns the codes before they are compressed."""
        light = sensor / FULL
        if self.smoothing:
            light = cv2.GaussianBlur(light, (0, 0), self.smoothing)
        seen = light ** (1 / self.curve) if isinstance(self.curve, float) else CURVES[self.curve](light)
        if self.sharpening:
            seen = np.clip(seen + self.sharpening * (seen - cv2.GaussianBlur(seen, (0, 0), 1.0)), 0, 1)
        full = (1 << self.bits) - 1
        return np.rint(full * seen).astype(np.uint8 if self.bits == 8 else np.uint16)


def _srgb(light: FloatArray) -> FloatArray:
    """Apply the sRGB curve (IEC 61966-2-1)."""
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-9) ** (1 / 2.4) - 0.055)


def _vendor(light: FloatArray) -> FloatArray:
    """Apply a vendor's picture style: sRGB, then an S that lifts highlights and lowers shadows, on a raised black."""
    codes = _srgb(light)
    steep = 4.0
    curve = np.tanh(steep * (codes - 0.5) / 2) / np.tanh(steep / 4)
    return 0.02 + 0.97 * (0.6 * codes + 0.4 * (0.5 + 0.5 * curve))


def _contrast(light: FloatArray) -> FloatArray:
    """Apply an S curve: shadows darker, highlights brighter."""
    return light * light * (3 - 2 * light)


CURVES = {
    "linear": lambda light: light,
    "srgb": _srgb,
    "vendor": _vendor,
    "S": _contrast,
    "srgb, then S": lambda light: _contrast(_srgb(light)),
    "raised": lambda light: 0.1 + 0.9 * np.sqrt(light),
    "logarithm": lambda light: np.log1p(40 * light) / np.log(41),
    "weak S": lambda light: 0.6 * light + 0.4 * _contrast(light),
}
RAW = Stored(bits=16)

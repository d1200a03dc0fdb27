"""A projector's conversion of code values to light.

It has a curve per channel, a black level, and perhaps a white segment or colour processing.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tests.rig.rays import FloatArray

FINE_CODES = np.arange(256) / 255
NEXT_SHARES = np.array([0.7, 0.45, 0.6])  # weight of the next primary in m, per primary; the other one has the rest
ROUNDS = 12  # rounds that invert colour processing; each leaves at most a fifth of the error


@dataclass(frozen=True)
class Projector:
    """A projector.

    gammas : gammas of red, green and blue; None: sRGB's curve.
    black : light at code 0, a share of full drive.
    white_segment : w. Codes whose darkest channel gives m show w m² more white; full white is 1 + w. 0: no segment.
    vividness : b. Colour processing gives a primary 1 + b (1 − m) of its light, with m a mean of the other codes.
    lamp : remaining share of the light of a new lamp.
    lamp_colour : remaining shares of each primary.
    """

    gammas: tuple[float, float, float] | None = (2.1, 2.2, 2.35)
    black: float = 0.002
    white_segment: float = 0.0
    vividness: tuple[float, float, float] | None = None
    lamp: float = 1.0
    lamp_colour: tuple[float, float, float] = (1.0, 1.0, 1.0)

    def curve(self, codes: FloatArray) -> FloatArray:
        """Returns light above black for codes 0..1, relative to white; the last axis is the channel."""
        if self.gammas is None:
            return np.where(codes <= 0.04045, codes / 12.92, ((codes + 0.055) / 1.055) ** 2.4)  # IEC 61966-2-1
        return np.asarray(codes ** np.asarray(self.gammas))

    def light(self, codes: NDArray[np.uint8]) -> FloatArray:
        """Returns the drive of each primary: (height, width, 3) codes -> (projector pixels, 3)."""
        shares = codes.reshape(-1, 3) / 255.0
        shown = self.curve(shares) * self._boost(shares)
        shown = shown + self.white_segment * shown.min(axis=1, keepdims=True) ** 2
        return np.asarray(self.lamp * np.array(self.lamp_colour) * (self.black + (1 - self.black) * shown))

    @property
    def brightest(self) -> float:
        """Light of full white."""
        return self.lamp * (self.black + (1 - self.black) * (1 + self.white_segment))

    def nearest_codes(self, light: FloatArray, raster: tuple[int, int]) -> NDArray[np.uint8]:
        """Returns the codes with the nearest light: (projector pixels, 3) -> (height, width, 3).

        With a white segment, codes whose darkest channel gives m show w m² more, so the darkest light is m + w m².
        """
        if self.white_segment:
            lowest = light.min(axis=1, keepdims=True) / self.lamp - self.black
            share = np.maximum(lowest, 0) / (1 - self.black)
            darkest = (np.sqrt(1 + 4 * self.white_segment * share) - 1) / (2 * self.white_segment)
            light = light - self.lamp * (1 - self.black) * self.white_segment * darkest**2
        table = self.curve(np.repeat(FINE_CODES[:, None], 3, axis=1))
        middles = (table[1:] + table[:-1]) / 2
        shown, codes = (light / self.lamp - self.black) / (1 - self.black), np.zeros_like(light)
        for _ in range(ROUNDS if self.vividness else 1):
            alone = shown / self._boost(codes)
            codes = np.stack([np.searchsorted(middles[:, i], alone[:, i]) for i in range(3)], axis=1) / 255
        return np.rint(255 * codes).astype(np.uint8).reshape(*raster, 3)

    def _boost(self, shares: FloatArray) -> FloatArray | float:
        """Returns the factor of colour processing: 1 at white, 1 + b for a primary alone. Codes are (pixels, 3)."""
        if self.vividness is None:
            return 1.0
        others = NEXT_SHARES * np.roll(shares, -1, axis=1) + (1 - NEXT_SHARES) * np.roll(shares, -2, axis=1)
        return np.asarray(1 + np.array(self.vividness) * (1 - others))

    def response_table(self) -> list[list[float]]:
        """Returns the curve at every code, as a measurement would give it: 256 rows of red, green and blue."""
        return [[float(value) for value in row] for row in self.curve(np.repeat(FINE_CODES[:, None], 3, axis=1))]

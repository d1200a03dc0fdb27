"""Points spread evenly over a round lens."""

from dataclasses import dataclass

import numpy as np

from counterlight.arrays import FloatArray, IntArray

PLASTIC = 1.32471795724474602596  # powers of PLASTIC make the R2 sequence (Roberts 2018)


@dataclass(frozen=True)
class LensPoints:
    """Points on a disc of diameter `aperture`: the R2 sequence through a concentric map (Shirley and Chiu 1997)."""

    aperture: float

    def of(self, pixels: IntArray, count: int) -> tuple[FloatArray, FloatArray]:
        """Returns (rows, count) points (across, up), given the pixel of each row.

        Rows of one pixel take different points.
        Each pixel's sequence has its own shift, so that neighbours do not share a pattern.
        """
        order = np.argsort(pixels, kind="stable")
        ordered = pixels[order]
        first = np.concatenate([[0], np.flatnonzero(np.diff(ordered)) + 1]) if pixels.size else np.zeros(0, np.int64)
        sizes = np.diff(np.append(first, pixels.size))
        turn = np.empty(pixels.size, np.int64)
        turn[order] = np.arange(pixels.size) - np.repeat(first, sizes)
        step = turn[:, None] * count + np.arange(count)
        shift = pixels[:, None] * np.array([0.754877666, 0.569840291]) * 7.13
        s = (0.5 + step / PLASTIC + shift[:, :1]) % 1.0
        t = (0.5 + step / PLASTIC**2 + shift[:, 1:]) % 1.0
        return self._disc(2 * s - 1, 2 * t - 1)

    def _disc(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        wide = np.abs(x) > np.abs(y)
        radius = np.where(wide, x, y)
        safe = np.where(radius == 0, 1.0, radius)
        angle = np.where(wide, np.pi / 4 * (y / safe), np.pi / 2 - np.pi / 4 * (x / safe))
        radius = radius * self.aperture / 2
        return radius * np.cos(angle), radius * np.sin(angle)

"""A projector's lens: lateral colour, and a halo of scattered light.

A primary's picture is the raster, scaled about its middle and shifted. The halo moves a share of each pixel's light to
its surroundings, also beyond the raster. Light leaves the lens on a raster with a margin: q = (1 − h) p + h K p.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tests.rig.rays import FloatArray

Pairs = tuple[tuple[float, float], tuple[float, float], tuple[float, float]]

REACH = 96 / 1024  # reach of the halo, as a share of the raster's width
SIGMAS = 2.0  # REACH in standard deviations of the halo


@dataclass(frozen=True)
class Lens:
    """A lens.

    shifts : of red, green and blue, projector pixels right and down.
    scales : of red, green and blue.
    halo : h, share of a pixel's light. Next to a large white area, the surroundings become brighter by h/2 of white.
    """

    shifts: Pairs = ((0.0, 0.0), (0.0, 0.0), (0.0, 0.0))
    scales: tuple[float, float, float] = (1.0, 1.0, 1.0)
    halo: float = 0.0

    def margin(self, raster: tuple[int, int]) -> int:
        """Returns the pixels that the halo adds on each side of a raster (height, width)."""
        return round(REACH * raster[1]) if self.halo else 0


SHARP = Lens()


class Emission:
    """The light that leaves a lens: q of a drive p. Both are (pixels, 3), q with the margin.

    raster : (height, width) of p.
    """

    def __init__(self, lens: Lens, raster: tuple[int, int]) -> None:
        self._raster, self._margin, self._halo = raster, lens.margin(raster), lens.halo
        self._rows, self._columns = (_scatter(side, self._margin) for side in raster)

    def __call__(self, drive: FloatArray) -> NDArray[np.float32]:
        if not self._halo:
            return np.asarray(drive, np.float32)
        picture = np.asarray(drive, np.float32).reshape(*self._raster, -1)
        scattered = np.tensordot(self._rows, np.tensordot(picture, self._columns, (1, 1)), (1, 0)).swapaxes(1, 2)
        return (self._unscattered(picture) + self._halo * scattered).reshape(-1, picture.shape[2]).astype(np.float32)

    def adjoint(self, light: FloatArray) -> FloatArray:
        """Returns the transpose's product: q (pixels with margin, 3) -> (pixels, 3)."""
        if not self._halo:
            return light
        (height, width), margin = self._raster, self._margin
        picture = light.reshape(height + 2 * margin, width + 2 * margin, -1)
        back = np.tensordot(self._rows, np.tensordot(picture, self._columns, (1, 0)), (0, 0)).swapaxes(1, 2)
        kept = picture[margin : margin + height, margin : margin + width]
        return np.asarray((1 - self._halo) * kept + self._halo * back).reshape(-1, picture.shape[2])

    def unscattered(self, drive: FloatArray) -> FloatArray:
        """Returns the part of q outside the halo."""
        if not self._halo:
            return drive
        return self._unscattered(drive.reshape(*self._raster, -1)).reshape(-1, drive.shape[1])

    def _unscattered(self, picture: NDArray[np.floating]) -> FloatArray:
        sides = self._margin, self._margin
        return np.asarray((1 - self._halo) * np.pad(picture, (sides, sides, (0, 0))))


def _scatter(side: int, margin: int) -> NDArray[np.float32]:
    """Returns K along an axis, (side + 2 margin, side): a Gaussian of unit sum, cut at the margin."""
    away = np.arange(-margin, side + margin)[:, None] - np.arange(side)
    weights = np.where(np.abs(away) <= margin, np.exp(-((SIGMAS * away / max(margin, 1)) ** 2) / 2), 0)
    return np.asarray(weights / weights.sum(axis=0), np.float32)

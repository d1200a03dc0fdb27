"""What camera pixels saw of known pictures, as equations for the projector pixels around their places.

Channel k of a camera pixel sees c_k = Σ_l F_kl s_l of a picture p, F its primaries' light and s_l = Σ_j t_j p_jl the
share that it has of primary l. The shape t is the same for all of them: a picture is three equations for it,

    c_k / L_k = Σ_j (Σ_l F_kl / L_k · p_jl) t_j,    L_k = Σ_l F_kl
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import BoolArray, FloatArray, IntArray
from counterlight.tools.acquisition.few.order import Order
from counterlight.tools.acquisition.plan import Reference

SUMMED = 12**0.5  # times a capture's noise that of a floodlight is: of three captures, each less the same black
CLEAR = 2.5  # times that, which the floodlight must raise a channel of a camera pixel by
LEAST_SIGMA = 1e-4  # of the floodlight: no capture is nearer to the truth
NUMBERS_AT_ONCE = 1 << 24  # in the equations of some camera pixels
Table = NDArray[np.float32]  # (256, 3), each primary's light for a code


@dataclass(frozen=True)
class Seen:
    """above : (pictures, camera pixels, 3) float32, radiance above black.  primaries : F, (camera pixels, channel,
    primary).  room : their sum, and the noise.
    """

    order: Order
    room: Reference
    primaries: FloatArray
    above: NDArray[np.float32]

    @property
    def count(self) -> int:
        return len(self.above)

    @property
    def camera(self) -> tuple[int, int]:
        height, width = self.room.black.shape[:2]
        return height, width

    @cached_property
    def codes(self) -> NDArray[np.uint8]:
        """(pictures, projector pixels, 3)."""
        return np.stack([codes.reshape(-1, 3) for codes in self.order.pictures(self.count)])

    @cached_property
    def light(self) -> FloatArray:
        """L, (camera pixels, 3); 0 where it is lost in noise."""
        light = self.primaries.sum(axis=2)
        return np.where(light > CLEAR * SUMMED * self.room.noise.dark, light, 0)

    @cached_property
    def lit(self) -> BoolArray:
        return np.asarray(np.any(self.light > 0, axis=1) & ~self.room.saturated.ravel())

    @cached_property
    def mixture(self) -> FloatArray:
        """F / L, (camera pixels, channel, primary)."""
        light = self.light[..., None]
        return np.divide(self.primaries, light, out=np.zeros_like(self.primaries), where=light > 0)

    @cached_property
    def clarity(self) -> FloatArray:
        """How little the floodlight's noise is beside it, (camera pixels, 3): weights of channels and of neighbours."""
        return np.where(self.lit[:, None], self.light**2 / self.room.noise.sigma(self.light) ** 2, 0)

    def captured(self, pixels: IntArray, pictures: Sequence[int]) -> FloatArray:
        """Light above black, (n, pictures, 3)."""
        return np.asarray(self.above[np.asarray(pictures)[:, None], pixels].transpose(1, 0, 2), np.float64)

    def grey_share(self, picture: int) -> FloatArray:
        """Of a grey picture, all channels as far as they are clear: (camera pixels,)."""
        total, light = self.clarity.sum(axis=1), self.light
        share = np.divide(self.above[picture], light, out=np.zeros_like(light), where=light > 0)
        summed: FloatArray = (self.clarity * share).sum(axis=1)
        return np.asarray(np.divide(summed, total, out=np.zeros_like(total), where=total > 0))

    @cached_property
    def grey_mixture(self) -> FloatArray:
        """What of a grey share each primary gives, on the whole: (3,)."""
        return np.asarray(np.einsum("nk,nkl->l", self.clarity, self.mixture) / self.clarity.sum())

    def drive(
        self, table: Table, mixture: FloatArray, columns: IntArray, pictures: Sequence[int]
    ) -> NDArray[np.float32]:
        """Σ_l r_kl p_jl of projector pixels j (n, window): (n, pictures · 3, window).

        mixture : r, (n, channel, primary), F / L or what of it is near light.
        """
        codes, mixture = self._codes_at(columns, pictures), mixture.astype(np.float32)
        seen = np.zeros((len(columns), len(pictures), 3, columns.shape[1]), np.float32)
        for primary in range(3):
            light = table[:, primary][codes[..., primary]].transpose(1, 0, 2)
            seen += mixture[:, None, :, primary, None] * light[:, :, None]
        return seen.reshape(len(columns), -1, columns.shape[1])

    def shares(
        self, table: Table, kernel: NDArray[np.floating], columns: IntArray, pictures: Sequence[int]
    ) -> FloatArray:
        """Σ_j t_j p_jl of each primary, (n, pictures, 3); kernel : t, (n, window)."""
        codes = self._codes_at(columns, pictures)
        return np.stack([np.einsum("pnw,nw->np", table[:, i][codes[..., i]], kernel) for i in range(3)], axis=2)

    def _codes_at(self, columns: IntArray, pictures: Sequence[int]) -> NDArray[np.uint8]:
        """(pictures, n, window, 3)."""
        return np.asarray(self.codes[np.asarray(pictures)[:, None, None], columns])

    def targets(self, pixels: IntArray, pictures: Sequence[int]) -> tuple[FloatArray, FloatArray]:
        """What `drive` is to give, c / L, and its noise, (n, pictures · 3): infinite where a channel sees nothing."""
        captured, light = self.captured(pixels, pictures), self.light[pixels][:, None]
        share = np.divide(captured, light, out=np.zeros_like(captured), where=light > 0)
        noise = self.room.noise.sigma(captured)
        sigma = np.divide(noise, light, out=np.full_like(noise, np.inf), where=light > 0) + LEAST_SIGMA
        return share.reshape(len(pixels), -1), sigma.reshape(len(pixels), -1)


def some(pixels: IntArray, numbers: int) -> Iterator[slice]:
    """Parts of them, of each of which the equations hold so many numbers."""
    at_once = max(NUMBERS_AT_ONCE // max(numbers, 1), 16)
    yield from (slice(start, start + at_once) for start in range(0, len(pixels), at_once))

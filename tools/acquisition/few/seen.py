"""Captures of known pictures as equations for the projector pixels around each camera pixel's place.

Channel k of a camera pixel sees c_k = Σ_l F_kl s_l of a picture p. F is the light of its primaries, and s_l = Σ_j t_j
p_jl is its share of primary l. The shape t is common to all primaries, so a picture gives three equations for it:

    c_k / L_k = Σ_j (Σ_l F_kl / L_k · p_jl) t_j,    L_k = Σ_l F_kl

Black, the three primaries and the camera's noise come from one picture each or, with white, from several.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from counterlight.arrays import BoolArray, FloatArray, IntArray
from counterlight.tools.acquisition.few.order import BLACK, PRIMARIES, Order
from counterlight.tools.acquisition.plan import MAD_TO_SIGMA, Noise, Reference

SUMMED = 12**0.5  # noise of a floodlight over the noise of a capture: it sums three captures, each minus the same black
CLEAR = 2.5  # least rise of a channel by the floodlight, in multiples of the floodlight's noise
LEAST_SIGMA = 1e-4  # least error assumed of a capture, as a share of the floodlight
NUMBERS_AT_ONCE = 1 << 24  # numbers in the equations processed at a time
Table = NDArray[np.float32]  # (256, 3), each primary's light per code value
USUAL_ELECTRONS = 1e4  # electrons of the brightest light, assumed until a white picture gives the photon noise
LEVELS = 16  # brightness levels at which noise is measured
BRIGHT = 99.0  # percentile of the floodlight that counts as its brightest light
LEAST_STEP = 1e-5  # rounding of 16 bits, as a share of the brightest light


@dataclass(frozen=True)
class Seen:
    """The captures of one camera.

    room : sum of the primaries, and the noise.
    primaries : (camera pixels, channel, primary). F.
    above : (pictures, camera pixels, 3) float32. Radiance above black.
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
        """Code values of all pictures, (pictures, projector pixels, 3)."""
        return np.stack([codes.reshape(-1, 3) for codes in self.order.pictures(self.count)])

    @cached_property
    def light(self) -> FloatArray:
        """L, the floodlight, (camera pixels, 3); 0 where noise hides it."""
        light = self.primaries.sum(axis=2)
        return np.where(light > CLEAR * SUMMED * self.room.noise.dark, light, 0)

    @cached_property
    def lit(self) -> BoolArray:
        return np.asarray(np.any(self.light > 0, axis=1) & ~self.room.saturated.ravel())

    @cached_property
    def mixture(self) -> FloatArray:
        """F / L, each primary's share of the floodlight, (camera pixels, channel, primary)."""
        light = self.light[..., None]
        return np.divide(self.primaries, light, out=np.zeros_like(self.primaries), where=light > 0)

    @cached_property
    def clarity(self) -> FloatArray:
        """Squared signal-to-noise ratio of the floodlight, (camera pixels, 3): weight of channels and neighbours."""
        return np.where(self.lit[:, None], self.light**2 / self.room.noise.sigma(self.light) ** 2, 0)

    def captured(self, pixels: IntArray, pictures: Sequence[int]) -> FloatArray:
        """Returns light above black, (n, pictures, 3)."""
        return np.asarray(self.above[np.asarray(pictures)[:, None], pixels].transpose(1, 0, 2), np.float64)

    def grey_share(self, picture: int) -> FloatArray:
        """Returns the share of a grey picture, over all channels weighted by clarity: (camera pixels,)."""
        total, light = self.clarity.sum(axis=1), self.light
        share = np.divide(self.above[picture], light, out=np.zeros_like(light), where=light > 0)
        summed: FloatArray = (self.clarity * share).sum(axis=1)
        return np.asarray(np.divide(summed, total, out=np.zeros_like(total), where=total > 0))

    @cached_property
    def grey_mixture(self) -> FloatArray:
        """Contribution of each primary to a grey share, averaged over the picture: (3,)."""
        return np.asarray(np.einsum("nk,nkl->l", self.clarity, self.mixture) / self.clarity.sum())

    def drive(
        self, table: Table, mixture: FloatArray, columns: IntArray, pictures: Sequence[int]
    ) -> NDArray[np.float32]:
        """Returns Σ_l r_kl p_jl of projector pixels j (n, window): (n, pictures · 3, window).

        mixture : (n, channel, primary). r: F / L, or its near part.
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
        """Returns Σ_j t_j p_jl of each primary, (n, pictures, 3); `kernel` is t, (n, window)."""
        codes = self._codes_at(columns, pictures)
        return np.stack([np.einsum("pnw,nw->np", table[:, i][codes[..., i]], kernel) for i in range(3)], axis=2)

    def _codes_at(self, columns: IntArray, pictures: Sequence[int]) -> NDArray[np.uint8]:
        """Returns code values, (pictures, n, window, 3)."""
        return np.asarray(self.codes[np.asarray(pictures)[:, None, None], columns])

    def targets(self, pixels: IntArray, pictures: Sequence[int]) -> tuple[FloatArray, FloatArray]:
        """Returns the target of `drive`, c / L, and its noise, (n, pictures · 3); infinite for unlit channels."""
        captured, light = self.captured(pixels, pictures), self.light[pixels][:, None]
        share = np.divide(captured, light, out=np.zeros_like(captured), where=light > 0)
        noise = self.room.noise.sigma(captured)
        sigma = np.divide(noise, light, out=np.full_like(noise, np.inf), where=light > 0) + LEAST_SIGMA
        return share.reshape(len(pixels), -1), sigma.reshape(len(pixels), -1)


def some(pixels: IntArray, numbers: int) -> Iterator[slice]:
    """Yield slices of pixels whose equations fit into memory; each pixel needs `numbers` numbers."""
    at_once = max(NUMBERS_AT_ONCE // max(numbers, 1), 16)
    yield from (slice(start, start + at_once) for start in range(0, len(pixels), at_once))


def reference(order: Order, captures: Sequence[NDArray[np.floating]], saturated: BoolArray) -> Seen:
    """Make the equations of the captures.

    captures : (camera height, camera width, 3) each. Radiance of the first pictures.
    saturated : (camera height, camera width) bool. Pixels saturated in any capture.
    """
    black = np.asarray(captures[BLACK], np.float64)
    above = np.stack([(capture - black).astype(np.float32).reshape(-1, 3) for capture in captures])
    primaries = np.stack([above[number] for number in PRIMARIES], axis=2).astype(np.float64)
    floodlight = primaries.sum(axis=2)
    whites = order.whites(len(captures))
    room = Reference(black, black + floodlight.reshape(black.shape), Noise(np.zeros(3), np.zeros(3)), saturated)
    noise = _by_white(above[whites[0]] - floodlight, floodlight, black) if whites else noise_by_neighbours(room)
    return Seen(order, replace(room, noise=noise), primaries, above)


def noise_by_neighbours(room: Reference) -> Noise:
    """Estimate the noise. Dark noise comes from differences of neighbouring pixels, which are an upper bound.

    Photon noise is assumed to be that of USUAL_ELECTRONS.
    """
    changes = (room.black[:, 1:] - room.black[:, :-1]).reshape(-1, 3) / np.sqrt(2)
    bright = np.percentile(room.light, BRIGHT, axis=0)
    dark = MAD_TO_SIGMA * np.median(np.abs(changes), axis=0)
    return Noise(np.maximum(dark, LEAST_STEP * bright.max()), np.maximum(bright, 0) / USUAL_ELECTRONS)


def _by_white(unadded: FloatArray, floodlight: FloatArray, black: FloatArray) -> Noise:
    """Fit the noise to white minus the sum of red, green and blue.

    unadded : (camera pixels, 3). Combines five captures, with black counted twice.

    Its variance at light L is 8 dark² + 2 gain L. A part proportional to light is no noise: light that does not add up.
    """
    dark, gain = np.zeros(3), np.zeros(3)
    for i in range(3):
        light = np.maximum(floodlight[:, i], 0)
        share = float(np.dot(light, unadded[:, i]) / max(np.dot(light, light), 1e-30))
        order = np.argsort(light)
        parts = np.array_split(order, LEVELS)
        off = unadded[:, i] - share * light
        variance = np.array([(MAD_TO_SIGMA * np.median(np.abs(off[part]))) ** 2 for part in parts])
        design = np.stack([np.full(LEVELS, 8.0), [2 * light[part].mean() for part in parts]], axis=1)
        # the error of a measured variance is proportional to the variance
        weights = 1 / np.maximum(variance, 1e-4 * variance.max() + 1e-30)
        (dark2, gain[i]), _ = nnls(design * weights[:, None], variance * weights)
        dark[i] = np.sqrt(max(dark2, gain[i] * float(black[..., i].mean())))
    least = LEAST_STEP * float(np.percentile(floodlight, BRIGHT))
    return Noise(np.maximum(dark, least), gain)

"""A room in coordinates in which its channels nearly decouple: T̃, and the mixing between T̃ and the camera's colours.

independent : each camera channel is assumed to see one primary alone; T̃ = T.
global : T̃_k = Σ_j Q_kj T_j, with Q the inverse of M₀, the mixing of a neutral surface.
pixel : T̃_l = Σ_j (A Q)_lj T_j in each camera pixel, with A of counterlight.maps.mixing, from floodlights F of the
    primaries: T̃_l·1 = w_l, w_l² = Σ_k (QF)²_kl.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import BoolArray, FloatArray, IntArray, brief
from counterlight.calibration import Calibration
from counterlight.errors import InputError
from counterlight.maps.mixing import Mixing, invertible
from counterlight.pipeline.content import reachable_white
from counterlight.tools.choices import COLOURS
from counterlight.tools.colour.neutral import counted_pixels, neutral_mixing
from counterlight.tools.transport.mixing import mixed_channels
from counterlight.tools.transport.transport import Transport

# share of a primary's light in wrong channels: an error of 50 dB, which is as good as the best compensation
WORTH = 0.003
WORST_MIXED = 20.0  # largest entry of A; camera pixels beyond it are treated as neutral
AS_ASKED = "as asked"
AGREEMENT = 2.0  # F·1 and T·1 differ by at most this factor; otherwise one of them is no measurement


@dataclass(frozen=True)
class Tier:
    """A room in one of the colour tiers.

    transport : T̃.
    mixing : conversion between T̃'s light and the camera's colours.
    reason : why this tier was chosen, one line.
    """

    calibration: Calibration
    transport: Transport
    mixing: Mixing
    reason: str

    __repr__ = brief

    @cached_property
    def ambient(self) -> NDArray[np.float32]:
        """Ambient light in screen primaries, (camera height, camera width, 3)."""
        return self.mixing.on_screen(self.calibration.ambient).astype(np.float32, copy=False)

    @cached_property
    def reach(self) -> FloatArray:
        """The brightest grey that each primary allows a camera pixel, (camera height, camera width, 3)."""
        full = self.transport.composition().reshape(self.calibration.ambient.shape)
        return np.asarray(self.mixing.reach(full, self.ambient), np.float64)

    @cached_property
    def white(self) -> float:
        """`--white auto`: the radiance of a white picture that most of the room can reach."""
        return float(reachable_white(self.reach, self.calibration.mask))

    def target(self, desired: FloatArray) -> FloatArray:
        """Return b: the light that T̃ must give for a picture in screen primaries, (camera height, camera width, 3)."""
        return np.asarray(self.mixing.unmixed(desired - self.ambient), np.float64)

    def seen(self, drive: FloatArray) -> FloatArray:
        """Return the camera picture of a drive, in screen primaries. drive : (projector pixels, 3) or a picture."""
        light = self.transport.apply(drive.reshape(-1, 3)).reshape(self.ambient.shape)
        return np.asarray(self.mixing.seen(light) + self.ambient, np.float64)

    def dual(self, picture: FloatArray) -> FloatArray:
        """Return the room lit by the camera, seen from the projector: the transpose of `seen` without ambient light."""
        light = np.asarray(self.mixing.seen_transpose(picture), np.float64)
        lit = self.transport.apply_transpose(light.reshape(-1, 3))
        return lit.reshape(*self.calibration.projector.shape, 3)

    def __str__(self) -> str:
        return f"colour: {self.mixing.tier}: {self.reason}"


def tier_of(calibration: Calibration, transport: Transport, colour: str = "auto") -> Tier:
    """Return a room in the requested tier of COLOURS; "auto" chooses the simplest that explains the measurements.

    Raises InputError if the calibration lacks the measurements for the tier.
    """
    if colour not in COLOURS:
        raise InputError(f"--colour {colour}: expected one of {', '.join(COLOURS)}")
    if colour == "independent":
        return Tier(calibration, transport, Mixing(), AS_ASKED)
    neutral, lack = _neutral(calibration)
    if lack:
        if colour == "auto":
            return Tier(calibration, transport, Mixing(), lack)
        raise InputError(f"--colour {colour}: {lack}; measure them with counterlight acquire, or leave the option out")
    if colour == "global":
        return _global(calibration, transport, neutral, AS_ASKED)
    composition = transport.composition()
    residual = _mixing_of_pixels(calibration, composition, neutral, counted_pixels(calibration.mask)).residual
    said = f"one mixing for the room leaves {100 * residual:.2g} % of a primary's light in wrong channels"
    if colour == "auto" and residual <= WORTH:
        return _global(calibration, transport, neutral, said)
    found = _mixing_of_pixels(calibration, composition, neutral, np.arange(calibration.mask.size))
    if not found.known[calibration.mask.ravel()].any():
        said += "; no camera pixel's floodlights add up to what the patterns found, so that all are taken for neutral"
    mixing = Mixing(neutral, found.B.reshape(*calibration.camera.shape, 3, 3).astype(np.float32))
    return Tier(calibration, mixed_channels(transport, np.linalg.inv(found.B) @ mixing.to_screen), mixing, said)


def _neutral(calibration: Calibration) -> tuple[FloatArray, str]:
    """Return M₀, and the name of the measurement that the room lacks to find it, or ""."""
    if calibration.primaries is None:
        return np.eye(3), "the calibration holds no floodlights of the primaries"
    neutral = neutral_mixing(calibration.primaries, calibration.mask)
    if not invertible(neutral):
        return np.eye(3), "its floodlights of the primaries cannot be distinguished"
    return neutral, ""


def _global(calibration: Calibration, transport: Transport, neutral: FloatArray, reason: str) -> Tier:
    mixing = Mixing(neutral)
    return Tier(calibration, mixed_channels(transport, mixing.to_screen), mixing, reason)


@dataclass(frozen=True)
class _Mixings:
    """The mixing of some camera pixels.

    B : (pixels, 3, 3).
    known : (pixels,) bool. Pixels with their own mixing.
    """

    B: FloatArray
    known: BoolArray

    @property
    def residual(self) -> float:
        """The error of the global tier: root mean square of the sines between B's columns and their axes."""
        sines = 1 - np.einsum("ill->il", self.B[self.known]) ** 2
        return float(np.sqrt(np.mean(np.maximum(sines, 0)))) if self.known.any() else 0.0


def _mixing_of_pixels(
    calibration: Calibration, composition: FloatArray, neutral: FloatArray, pixels: IntArray
) -> _Mixings:
    """Return mixings from floodlights that are positive and agree with T·1; other pixels count as neutral."""
    assert calibration.primaries is not None
    Q = Mixing(neutral).to_screen
    F, known = _scaled_floodlights(calibration.primaries.reshape(3, -1, 3)[:, pixels], composition[pixels])
    P = Q @ F
    lengths = np.linalg.norm(P, axis=1)
    known &= (np.einsum("ill->il", P) > 0).all(axis=1) & (lengths > 0).all(axis=1)
    B = np.where(known[:, None, None], P, np.eye(3)) / np.where(known[:, None], lengths, 1)[:, None]
    known &= invertible(B, WORST_MIXED)
    B[~known] = np.eye(3)
    return _Mixings(B, known)


def _scaled_floodlights(primaries: NDArray[np.float32], composition: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return F, (pixels, 3, 3), with rows scaled to T·1, and the pixels where both agree to AGREEMENT.

    Every pattern measured the light of grey; F gives the share of each primary.
    """
    F = np.moveaxis(primaries.astype(np.float64), 0, -1)
    total = F.sum(axis=-1)
    agrees = (composition > 0) & (total * AGREEMENT > composition) & (total < AGREEMENT * composition)
    known = np.asarray(agrees.all(axis=1))
    scale = np.divide(composition, total, out=np.zeros_like(total), where=known[:, None])
    return scale[..., None] * F, known

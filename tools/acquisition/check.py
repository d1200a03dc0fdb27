"""Check an acquisition: predict pictures that no scheme has seen, and compare with their captures.

A black-and-white pattern tests T alone. A picture of greys and colours also tests the response and the primaries. The
camera's channel k sees c_k = Σ_l r_kl (T_k p_l), where T is measured with white and r_kl = F_kl / Σ_l F_kl is the share
of a pixel's light that each primary gives.
"""

from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray
from counterlight.passes.encode import encoded
from counterlight.pipeline.content import reachable_white
from counterlight.response import Response
from counterlight.tools.acquisition.plan import Codes, Pattern, Reference
from counterlight.tools.inverse.pictures import noise_picture
from counterlight.tools.transport.transport import Transport

CELL = 4  # side of the random cells, in projector pixels
PHOTOGRAPHS, SLOPE = 2, 2.0  # number, and the fall of their spectra: soft photographs
TINT = 0.3  # share of a photograph's light that differs between the channels
GREYS, COLOURS = (48, 208), (32, 224)  # code values that are neither near black nor clipped
CLEARLY_LIT = 10  # multiple of the noise; in darker pixels, the shares of the primaries are unknown
SEED = 20060504

Scalar = TypeVar("Scalar", bound=np.generic)


@dataclass(frozen=True)
class Check:
    """The result of a check.

    error : RMS difference of predicted and captured light, relative to the captured light.
    noise : the part of the error that the camera's noise explains.
    of : name of the pictures.
    lights : predicted and captured light above black, (2, camera pixels, 3), or (2, pictures, camera pixels, 3).
    """

    error: float
    noise: float
    of: str = "a random pattern"
    lights: FloatArray | None = field(default=None, compare=False, repr=False)

    @property
    def excess(self) -> float:
        """The error that noise does not explain."""
        return float(np.sqrt(max(self.error**2 - self.noise**2, 0)))

    def __str__(self) -> str:
        return f"{100 * self.error:.1f} % (noise alone: {100 * self.noise:.1f} %)"


def check_pattern(projector: tuple[int, int]) -> Pattern:
    """Returns random cells, half of them lit; the seed is fixed."""
    return _cells(np.random.default_rng(SEED).random(_count(projector)) < 0.5, projector)


def check_colours(projector: tuple[int, int]) -> Codes:
    """Returns random cells, half of them grey, half coloured; the seed is fixed."""
    rng, count = np.random.default_rng(SEED + 1), _count(projector)
    greys = rng.integers(*GREYS, (*count, 1), np.uint8)
    colours = rng.integers(*COLOURS, (*count, 3), np.uint8)
    return _cells(np.where(rng.random((*count, 1)) < 0.5, greys, colours), projector)


def check_photographs(
    transport: Transport, room: Reference, response: Response, projector: tuple[int, int]
) -> list[Codes]:
    """Returns compensated pictures with the spectra of photographs; the seeds are fixed.

    Direct mapping compensates: p = Tᵀ d / Tᵀ 1, with the drive d = white x / T 1 of each camera pixel. The camera then
    sees pictures as from `play`, without the texture of the wall.
    """
    shape, found = room.black.shape, []
    full = transport.composition().reshape(shape)
    white = reachable_white(full, ~room.saturated & np.all(full > 0, axis=2))
    seen = np.maximum(transport.apply_transpose(np.ones((full.size // 3, 3))), np.finfo(float).tiny)
    for number in range(PHOTOGRAPHS):
        grey, *colours = (noise_picture(shape[:2], SLOPE, SEED + 4 * number + each) for each in range(4))
        wanted = white * ((1 - TINT) * grey[..., None] + TINT * np.stack(colours, axis=-1))
        drive = np.clip(np.divide(wanted, full, out=np.zeros(shape), where=full > 0), 0, 1).reshape(-1, 3)
        mapped = (transport.apply_transpose(drive) / seen).reshape(*projector, 3)
        found.append(encoded(mapped, response.over(projector)))
    return found


def check_white(
    transport: Transport, room: Reference, pattern: Pattern, capture: FloatArray, *, wandering: bool = False
) -> Check:
    """Compare the capture of a pattern with its prediction by T alone.

    wandering : whether the capture's channels have unknown gains.
    """
    return _compared(transport.apply(_three(pattern.ravel())), room, capture, wandering=wandering)


def check_coloured(
    transport: Transport, room: Reference, codes: Codes, capture: FloatArray, response: Response,
    primaries: NDArray[np.float32], *, wandering: bool = False,
) -> Check:  # fmt: skip
    """Compare the capture of a picture with its prediction by T, a response and the primaries.

    codes : (projector height, projector width, 3) uint8. The picture.
    primaries : (3, camera height, camera width, 3). Light of each primary.
    wandering : whether the capture's channels have unknown gains.
    """
    drive = response.to_linear(codes.reshape(-1, 3) / 255.0)
    lights = np.maximum(primaries.reshape(3, -1, 3), 0)
    whole = lights.sum(axis=0, dtype=np.float64)
    clear = whole > CLEARLY_LIT * room.rise_noise
    predicted = np.zeros_like(whole)
    for primary, light in enumerate(lights):
        unclear = np.broadcast_to(np.arange(3) == primary, whole.shape).astype(np.float64)  # own channel: share 1
        share = np.divide(light, whole, out=unclear, where=clear)
        predicted += share * transport.apply(_three(drive[:, primary]))
    return replace(_compared(predicted, room, capture, wandering=wandering), of="random greys and colours")


def _compared(predicted: FloatArray, room: Reference, capture: FloatArray, *, wandering: bool) -> Check:
    seen = room.above_black(capture)
    if wandering:
        whole = np.maximum(np.sum(predicted**2, axis=0), np.finfo(float).tiny)
        predicted = predicted * np.sum(predicted * seen, axis=0) / whole
    scale = np.sqrt(np.sum(seen**2))
    noise = np.sqrt((1 + 1 / room.repeats) * np.sum(room.noise.sigma(seen) ** 2))
    error = float(np.sqrt(np.sum((predicted - seen) ** 2)) / scale)
    return Check(error, float(noise / scale), lights=np.stack([predicted, seen]))


def _three(values: NDArray[np.generic]) -> FloatArray:
    return np.repeat(values.astype(np.float64)[:, None], 3, axis=1)


def _count(projector: tuple[int, int]) -> tuple[int, int]:
    return -(-projector[0] // CELL), -(-projector[1] // CELL)


def _cells(values: NDArray[Scalar], projector: tuple[int, int]) -> NDArray[Scalar]:
    return values.repeat(CELL, axis=0).repeat(CELL, axis=1)[: projector[0], : projector[1]]

"""The impossible map: which camera pixels no projector picture can serve, and why.

Every test is on radiance, in the worst of the three channels, against the white level w that the map was built for.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from counterlight.calibration import Calibration
from counterlight.maps import RoomMaps
from counterlight.tools.relighting.views import far_light, inverse_dual
from counterlight.tools.transport.transport import Transport

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
MID_GREY = 0.5  # of white, linear
BLACK_SHARE = 0.1  # of white: brighter than this, black reads as dark grey
CONFLICT_SHARE = 0.1  # of mid grey: a difference that is seen beside an even grey
BOX_STEPS = 60
SLACK = 1e-6  # relative: T is float32


@dataclass(frozen=True)
class Reason:
    """Why a pixel cannot be served: a name for JSON, the legend's words and its colour (8-bit sRGB)."""

    name: str
    words: str
    colour: tuple[int, int, int]


SERVED = Reason("served", "can be corrected", (205, 205, 205))
REASONS = (
    Reason("unlit", "unlit: outside the mask, or no light from the projector in some channel", (40, 40, 40)),
    Reason("below_mid_grey", "cannot reach mid grey: full floodlight stays below 0.5 of white", (213, 60, 50)),
    Reason("below_white", "cannot reach white: full floodlight stays below white", (240, 160, 60)),
    Reason("bright_black", "too bright for black: over 0.1 of white arrives unasked in a grey picture", (70, 130, 220)),
    Reason("conflict", "conflict: a grey that each pixel could reach alone is missed by over 10 %", (160, 80, 190)),
)


@dataclass(frozen=True)
class Impossible:
    """Each reason's camera pixels; a pixel may have several, and is coloured by the first in the order of REASONS.

    flags : (reasons, camera height, camera width).
    """

    flags: BoolArray

    @property
    def first(self) -> NDArray[np.int64]:
        """(camera height, camera width): 0 where the pixel is served, else 1 + the index of its first reason."""
        return np.where(self.flags.any(axis=0), 1 + np.argmax(self.flags, axis=0), 0)

    def picture(self) -> NDArray[np.uint8]:
        """The map in the legend's colours."""
        return np.array([reason.colour for reason in (SERVED, *REASONS)], np.uint8)[self.first]

    def to_json(self) -> dict[str, dict[str, int]]:
        """Camera pixels per reason: shown (the first reason of the pixel) and all that have it."""
        shown = np.bincount(self.first.ravel(), minlength=1 + len(REASONS))
        every = [int(self.flags.size // len(REASONS) - self.flags.any(axis=0).sum()), *self.flags.sum(axis=(1, 2))]
        return {
            reason.name: {"shown": int(a), "all": int(b)}
            for reason, a, b in zip((SERVED, *REASONS), shown, every, strict=True)
        }


def find_impossible(transport: Transport, calibration: Calibration, maps: RoomMaps) -> Impossible:
    """Test every camera pixel; pixels that are unlit are tested for nothing else.

    With F = T·1 the floodlight, e the ambient light, w the white level, g = 0.5 w:
    unlit : outside the mask, or F = 0.   below_mid_grey : F + e < g.   below_white : F + e < w.
    bright_black : e + U M D p > 0.1 w with p the compensated even grey g: what a black pixel would still get.
    conflict : |T p* + e − t| > 0.1 g, t = clamp(g, e, F + e): a target that each pixel alone can reach; p* the best
    picture in 0..1 for all of them together, by 60 accelerated projected gradient steps (docs/mathematics.md): what is
    left is due to shared projector pixels, except for what further steps would still remove.
    """
    shape = *calibration.camera.shape, 3
    floodlight = transport.composition().reshape(shape)
    ambient = calibration.ambient.astype(np.float64)
    lit = calibration.mask & (floodlight > 0).all(axis=2)
    reach = (floodlight + ambient).min(axis=2) * (1 + SLACK)
    grey = MID_GREY * maps.white
    unasked = ambient + _far_light_of_grey(maps, grey - ambient)
    residual = _shared_grey_residual(transport, np.clip(grey - ambient, 0, floodlight), lit)
    flags = [
        reach < grey,
        reach < maps.white,
        unasked.max(axis=2) > BLACK_SHARE * maps.white,
        residual > CONFLICT_SHARE * grey,
    ]
    return Impossible(np.stack([~lit, *(flag & lit for flag in flags)]))


def _far_light_of_grey(maps: RoomMaps, light: FloatArray) -> FloatArray:
    if maps.far is None:
        return np.zeros_like(light)
    return far_light(maps.far, np.clip(inverse_dual(maps, light), 0, 1))


def _shared_grey_residual(transport: Transport, target: FloatArray, lit: BoolArray) -> FloatArray:
    """|T p* − b| in the worst channel, (camera height, camera width); unlit pixels ask for nothing."""
    asked = lit.ravel()[:, None]
    b = target.reshape(-1, 3)
    p = best_drive(transport, b, asked)
    return np.asarray((np.abs(transport.apply(p) - b) * asked).max(axis=1).reshape(lit.shape))


def best_drive(transport: Transport, b: FloatArray, asked: BoolArray, steps: int = BOX_STEPS) -> FloatArray:
    """Minimise ½‖asked · (T p − b)‖² over 0 ≤ p ≤ 1, (projector pixels, 3), per channel.

    T ≥ 0, so TᵀT ≼ diag(TᵀT1): the step is the gradient over d = TᵀT1, with Nesterov's momentum, restarted where it
    points uphill (O'Donoghue and Candès 2015).
    """
    d = transport.apply_transpose(asked * transport.composition())
    inverse = np.divide(1, d, out=np.zeros_like(d), where=d > 0)
    p = np.clip(inverse * transport.apply_transpose(asked * b), 0, 1)
    ahead, momentum = p, 1.0
    for _ in range(steps):
        gradient = transport.apply_transpose(asked * (transport.apply(ahead) - b))
        following = np.clip(ahead - inverse * gradient, 0, 1)
        if np.sum(gradient * (following - p)) > 0:
            momentum = 1.0
        grown = (1 + np.sqrt(1 + 4 * momentum**2)) / 2
        ahead = following + (momentum - 1) / grown * (following - p)
        p, momentum = following, grown
    return p

"""The impossible map: camera pixels whose target no projector picture can show, with the reason.

Every test is on radiance, in the worst of the three channels, against the white level w of the maps.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import BoolArray, FloatArray
from counterlight.maps.room_maps import RoomMaps
from counterlight.passes.reach import counted
from counterlight.passes.shown_maps import shortfalls
from counterlight.pipeline import views
from counterlight.pipeline.operators import compensation, prepared
from counterlight.pipeline.views import MID_GREY, SLACK
from counterlight.tools.colour.tiers import Tier
from counterlight.tools.solve.box import Box
from counterlight.tools.transport.transport import Transport

BLACK_SHARE = 0.1  # share of white from which black looks dark grey
CONFLICT_SHARE = 0.1  # share of mid grey that is visible as a difference next to an even grey
BOX_STEPS = 60


@dataclass(frozen=True)
class Reason:
    """Reason why no picture can show a pixel's target: a name for JSON, the legend's words and colour (8-bit sRGB)."""

    name: str
    words: str
    colour: tuple[int, int, int]


SERVED = Reason("served", "can be corrected", views.SERVED)
REASONS = (
    Reason("unlit", "unlit: outside the mask, or no light from the projector in some channel", views.UNLIT),
    Reason("below_mid_grey", "cannot reach mid grey: full floodlight stays below 0.5 of white", views.BELOW_MID_GREY),
    Reason("below_white", "cannot reach white: full floodlight stays below white", views.BELOW_WHITE),
    Reason("bright_black", "too bright for black: over 0.1 of white arrives unasked in a grey picture", (70, 130, 220)),
    Reason("conflict", "conflict: a grey that each pixel could reach alone is missed by over 10 %", (160, 80, 190)),
)


@dataclass(frozen=True)
class Impossible:
    """Camera pixels of each reason. A pixel may have several reasons; the first in REASONS gives its colour.

    flags : (reasons, camera height, camera width).
    """

    flags: BoolArray

    @property
    def first(self) -> NDArray[np.int64]:
        """(camera height, camera width): 0 for pixels without a reason, otherwise 1 + the index of the first reason."""
        return np.where(self.flags.any(axis=0), 1 + np.argmax(self.flags, axis=0), 0)

    def picture(self) -> NDArray[np.uint8]:
        """Returns the map in the legend's colours."""
        return np.array([reason.colour for reason in (SERVED, *REASONS)], np.uint8)[self.first]

    def to_json(self) -> dict[str, dict[str, int]]:
        """Returns two numbers of camera pixels per reason: pixels that show its colour, and all pixels that have it."""
        shown = np.bincount(self.first.ravel(), minlength=1 + len(REASONS))
        every = [int(self.flags.size // len(REASONS) - self.flags.any(axis=0).sum()), *self.flags.sum(axis=(1, 2))]
        return {
            reason.name: {"shown": int(a), "all": int(b)}
            for reason, a, b in zip((SERVED, *REASONS), shown, every, strict=True)
        }


def find_impossible(tier: Tier, maps: RoomMaps) -> Impossible:
    """Test every camera pixel; unlit pixels get no further test.

    With T·1 the composition, r the brightest grey that it allows (T·1 + e if channels are independent), e the ambient
    light, w the white level, g = 0.5 w:

    unlit : outside the mask, or T·1 = 0.
    below_mid_grey : r < g.
    below_white : r < w.
    bright_black : e + U M D p > 0.1 w, with p the compensated even grey g: the light that a black pixel still receives.
    conflict : |T p* − b| > 0.1 g, with b the light for g, clamped to 0 … T·1, a target that each pixel alone can reach.

    p* is the best picture in 0..1 for all pixels together, by 60 accelerated projected gradient steps
    (docs/mathematics.md). The rest is due to shared projector pixels, except for what further steps would remove.
    """
    ambient, mixing = tier.ambient.astype(np.float64), tier.mixing
    full = tier.transport.composition().reshape(ambient.shape)
    unlit, below_mid_grey, below_white = shortfalls(
        counted(tier.reach, tier.calibration.mask & np.all(full > 0, axis=2)),
        maps.white,
        MID_GREY * maps.white,
        SLACK,
    )
    grey = MID_GREY * maps.white
    light = tier.target(np.full_like(ambient, grey))
    unasked = ambient + mixing.seen(_far_light_of_grey(maps, light))
    residual = _shared_grey_residual(tier.transport, np.clip(light, 0, full), ~unlit)
    bright_black = ~unlit & (unasked.max(axis=2) > BLACK_SHARE * maps.white)
    conflict = ~unlit & (residual > CONFLICT_SHARE * grey)
    return Impossible(np.stack([unlit, below_mid_grey, below_white, bright_black, conflict]))


def _far_light_of_grey(maps: RoomMaps, light: FloatArray) -> FloatArray:
    far = prepared(maps.far)
    return np.zeros_like(light) if far is None else far.apply(np.clip(compensation(maps).apply(light), 0, 1))


def _shared_grey_residual(transport: Transport, target: FloatArray, lit: BoolArray) -> FloatArray:
    """Returns |T p* − b| in the worst channel, (camera height, camera width); unlit pixels have no target."""
    T, b = transport.inside(lit), (target * lit[..., None]).reshape(-1, 3)
    p, _ = Box(T, most_steps=BOX_STEPS).run(b)
    return np.asarray(np.abs(T.apply(p) - b).max(axis=1).reshape(lit.shape))

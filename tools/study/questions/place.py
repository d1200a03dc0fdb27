"""The room in which questions are tried, with pictures and their best drives."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.calibration import Calibration
from counterlight.pipeline.content import psnr
from counterlight.pipeline.fitting import on_cameras
from counterlight.tools.colour.tiers import Tier, tier_of
from counterlight.tools.solve.box import Box
from counterlight.tools.study.pictures import Picture
from counterlight.tools.transport.coarser import Blocks, below, coarser
from counterlight.tools.transport.objective import DEFAULT_AIMS, Objective, ObjectiveOptions, objective_of
from counterlight.tools.transport.transport import Transport

MOST_PIXELS = 160 * 120  # camera pixels
GAP = 1e-3  # relative gap of the box optimum: 0.004 dB


@dataclass(frozen=True)
class Place:
    """A calibrated room.

    factor : pixels per side of the full-size room that one pixel here represents.
    """

    calibration: Calibration
    transport: Transport
    pictures: Sequence[Picture]
    colour: str = "auto"
    factor: int = 1

    @cached_property
    def tier(self) -> Tier:
        return tier_of(self.calibration, self.transport, self.colour)

    @cached_property
    def desired(self) -> list[FloatArray]:
        """The desired pictures, (camera height, camera width, 3) each, in screen primaries."""
        room = self.calibration
        return [self.tier.white * on_cameras(picture.at(room.placed_on), room) for picture in self.pictures]

    @cached_property
    def best(self) -> list[FloatArray]:
        """The drive of each picture that the player's objective prefers, (projector pixels, 3)."""
        return self.drives(self.tier)

    @cached_property
    def reached(self) -> list[float]:
        """PSNR of each picture with the unweighted optimum."""
        box = Box(self._objective.unweighted, tolerance=GAP)
        return self.psnr([box.solve(self.tier.asked(each).reshape(-1, 3)).drive for each in self.desired])

    @cached_property
    def _objective(self) -> Objective:
        return objective_of(self.tier.transport, self.tier.calibration, DEFAULT_AIMS, self.tier.mixing)

    @property
    def size(self) -> str:
        """The size in words."""
        camera, projector = self.calibration.camera, self.calibration.projector
        words = f"camera {camera.width}x{camera.height}, projector {projector.width}x{projector.height}"
        return words if self.factor == 1 else f"{words}, each of its pixels {self.factor} a side of the room's own"

    def drives(
        self, tier: Tier, aims: ObjectiveOptions = DEFAULT_AIMS, desired: Sequence[FloatArray] | None = None
    ) -> list[FloatArray]:
        """Returns the best drive of each picture by the player's objective, in a tier of this or a derived room.

        desired : the pictures, if the derived camera has other pixels.
        """
        box = Box(objective_of(tier.transport, tier.calibration, aims, tier.mixing), tolerance=GAP)
        return [box.solve(tier.asked(each).reshape(-1, 3)).drive for each in desired or self.desired]

    def psnr(self, drives: Sequence[FloatArray], seen: Callable[[FloatArray], FloatArray] | None = None) -> list[float]:
        """Returns the PSNR of each picture's drive in this room.

        seen : function from a drive to the camera picture, if not as calibrated.
        """
        lit, look = self._objective.lit_picture(self.calibration), seen or self.tier.seen
        errors = [(look(p) - each)[lit] / self.tier.white for p, each in zip(drives, self.desired, strict=True)]
        return [psnr(float(np.mean(np.square(error)))) for error in errors]

    def below(self, drives: Sequence[FloatArray], seen: Callable[[FloatArray], FloatArray] | None = None) -> float:
        """Returns the decibels below the best, mean over the pictures."""
        return float(np.mean(np.array(self.reached) - np.array(self.psnr(drives, seen))))


def coarse(place: Place, most: int = MOST_PIXELS) -> Place:
    """Returns the room with at most `most` camera pixels, so that slow questions take minutes."""
    factor = int(np.ceil(np.sqrt(place.calibration.camera.pixels / most)))
    if factor == 1:
        return place
    small = made_coarser(place.calibration, place.transport, factor, factor)
    return Place(*small, place.pictures, place.colour, place.factor * factor)


def made_coarser(
    calibration: Calibration, transport: Transport, camera: int, projector: int
) -> tuple[Calibration, Transport]:
    """Returns the room with coarser devices: each pixel replaces a square block of its own pixels.

    camera, projector : side of a block, pixels.
    """
    seen, shown = blocks_of(calibration, camera, projector)
    primaries, screen = calibration.primaries, calibration.screen
    small = replace(
        calibration,
        camera=replace(calibration.camera, height=seen.coarse[0], width=seen.coarse[1]),
        projectors=tuple(
            replace(each, height=height, width=width)
            for each, (height, width) in zip(calibration.projectors, shown.coarser, strict=True)
        ),
        ambient=seen.mean(calibration.ambient).astype(np.float32),
        mask=seen.whole(calibration.mask),
        primaries=primaries if primaries is None else np.stack([seen.mean(each) for each in primaries]).astype("f4"),
        screen=screen
        and replace(screen, cameras=seen.coarser, positions=seen.mean(screen.positions).astype(np.float32)),
    )
    return small, coarser(transport, seen, shown)


def blocks_of(calibration: Calibration, camera: int, projector: int) -> tuple[Blocks, Blocks]:
    """Returns blocks of camera pixels and of projector pixels, `camera` and `projector` pixels per side."""
    projectors = tuple(each.shape for each in calibration.projectors)
    return Blocks(calibration.cameras, camera, below), Blocks(projectors, projector)

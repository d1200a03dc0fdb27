"""The closed loop: show a compensated picture, photograph it, and compare with the prediction and the target.

Rounds of feedback correct errors of T. The prediction's error δ = captured − predicted changes little between
similar pictures, so the next round solves T p + e + δ = desired. Adding the remaining error to the target would not
work: a drive in 0..1 cannot give much of it, and the rest of the picture would suffer.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from counterlight.arrays import BoolArray, FloatArray
from counterlight.calibration import StoredCalibration
from counterlight.maps.room_maps import read_maps
from counterlight.passes.encode import encoded, reached
from counterlight.pipeline.content import camera_psnr
from counterlight.pipeline.drift import Drift
from counterlight.pipeline.operators import compensation
from counterlight.pipeline.refinement import Certificate
from counterlight.tools.acquisition.photographer import Photographer
from counterlight.tools.acquisition.plan import Codes
from counterlight.tools.colour.tiers import tier_of
from counterlight.tools.solve.registry import prepare
from counterlight.tools.transport.interval import NOMINAL, Coverage, coverage, read_interval
from counterlight.tools.transport.objective import DEFAULT_AIMS, ObjectiveOptions, objective_of
from counterlight.tools.transport.transport import Transport

# PSNR in dB: prediction against target, capture against target, capture against prediction
Figures: TypeAlias = tuple[float, float, float]
OUT_OF_REACH = "need brighter colours than the projector can show"
MUCH_WORSE = 3.0  # dB; a capture that is this far below its prediction causes a warning


@dataclass(frozen=True)
class Verified:
    """One round: PSNR in dB of the prediction by T, of the capture, and of the capture against the prediction.

    certificate : certificate of the drive that should arrive.
    unreachable : share of the projector's pixels whose drive no code values give.
    codes : the code values shown.
    predicted, captured : (camera height, camera width, 3), screen primaries.
    cameras : the three figures per camera in use, by number from 1, if there are several.
    inside : captured values inside the room's prediction interval, in shares of white; None if the room has none.
    """

    round: int
    predicted_psnr: float
    measured_psnr: float
    model_psnr: float
    certificate: Certificate
    unreachable: float
    codes: Codes
    predicted: FloatArray
    captured: FloatArray
    cameras: dict[int, Figures]
    inside: Coverage | None = None

    def __str__(self) -> str:
        lines = [
            f"round {self.round}: {_in_words(self.predicted_psnr, self.measured_psnr, self.model_psnr)}",
            f"  {self.certificate}",
            *([f"  {100 * self.unreachable:.2g} % of the pixels {OUT_OF_REACH}"] if self.unreachable else []),
            *([] if self.inside is None else [_covered(self.inside)]),
            *(f"  camera {number}: {_in_words(*figures)}" for number, figures in self.cameras.items()),
        ]
        return "\n".join(lines)

    @property
    def as_predicted(self) -> bool:
        return self.predicted_psnr - self.measured_psnr < MUCH_WORSE

    @property
    def verdict(self) -> str:
        """The result in words."""
        short = self.predicted_psnr - self.measured_psnr
        if self.as_predicted:
            return f"the picture arrives as predicted, {self.measured_psnr:.1f} dB"
        return (
            f"the picture arrives {short:.1f} dB worse than predicted: focus, response or colours are not as the "
            "calibration has them; measure them, or acquire again"
        )


def _in_words(predicted: float, measured: float, model: float) -> str:
    return (
        f"predicted {predicted:.2f} dB, measured {measured:.2f} dB; the capture agrees with the prediction to "
        f"{model:.2f} dB"
    )


def _covered(found: Coverage) -> str:
    return (
        f"  {100 * found.share:.1f} % of the captured values are inside the {100 * NOMINAL:.0f} % interval of the room "
        f"({found.parts}), whose mean width is {100 * found.width:.2f} % of white; an interval of one width would need "
        f"{100 * found.constant:.2f} %"
    )


class Wanted:
    """A picture for a calibrated room and its solver, all read and checked before anything is shown.

    transport : T of the stored calibration.
    picture : (camera height, camera width, 3). Linear, 0 to 1, or the desired radiance itself if `radiance`.
    colour : one of choices.COLOURS; the solver `map` uses the colour of the maps.

    Raises InputError if the calibration lacks maps that the solver needs.
    """

    def __init__(
        self,
        stored: StoredCalibration,
        transport: Transport,
        picture: FloatArray,
        *,
        radiance: bool,
        solver: str,
        colour: str = "auto",
        aims: ObjectiveOptions = DEFAULT_AIMS,
    ) -> None:
        self.picture, self.radiance, self.aims = picture, radiance, aims
        maps = read_maps(stored) if solver == "map" else None
        self.T_pinv = None if maps is None else compensation(maps)
        self.tier = tier_of(stored.calibration, transport, colour if maps is None else maps.mixing.tier)
        self.objective = objective_of(self.tier.transport, stored.calibration, aims, self.tier.mixing)
        self.interval = read_interval(stored)


class Verification:
    """A picture in a calibrated room in its present state. Desired, predicted and captured light use screen primaries.

    drift : changes that are undone.
    used : per camera, whether its captures count.
    """

    def __init__(
        self,
        photographer: Photographer,
        stored: StoredCalibration,
        wanted: Wanted,
        drift: Drift,
        used: tuple[bool, ...],
    ) -> None:
        ambient = stored.calibration.ambient if drift.ambient is None else drift.ambient
        self._photographer, self._room, self._drift = photographer, replace(stored.calibration, ambient=ambient), drift
        self._cameras = {number: self._room.pixels_of(number - 1) for number, ask in enumerate(used, 1) if ask}
        self._seen: BoolArray = np.any(list(self._cameras.values()), axis=0)
        self._T_pinv, self._interval = wanted.T_pinv, wanted.interval
        self.tier = replace(wanted.tier, calibration=self._room)
        mixing = self.tier.mixing if drift.share is None else self.tier.mixing.shared(drift.share)
        self._now = replace(self.tier, mixing=mixing)
        same = drift.share is None and drift.ambient is None
        self._objective = (
            wanted.objective if same else objective_of(self.tier.transport, self._room, wanted.aims, mixing)
        )
        self._box = prepare("box", self.tier.transport, self._room.mask, self._objective)
        self.white = self.tier.white * drift.dimming
        self.desired: FloatArray = (
            np.asarray(self.tier.mixing.on_screen(wanted.picture), np.float64)
            if wanted.radiance
            else wanted.picture * self.white
        )

    def run(self, rounds: int, repeats: int) -> Iterator[Verified]:
        """Yield the plain compensation, then `rounds` of feedback; `repeats` captures of each are averaged."""
        target = self.desired
        for index in range(rounds + 1):
            b = self._now.target(target)
            light = self._objective.bounded(b.reshape(-1, 3)).reshape(b.shape)
            drive = self._drive(light)
            certificate = self._objective.certificate(drive, light.reshape(-1, 3))
            shown = self._drift.shown(drive.reshape(*self._room.projector.shape, 3), self._room.regions)
            codes = encoded(shown, self._room.response)
            unreachable = float(np.any(reached(shown, self._room.response, codes) != shown, axis=-1).mean())
            predicted = self._now.seen(self._arriving(codes))
            captured = np.asarray(self.tier.mixing.on_screen(self._photographer.mean(codes, repeats)), np.float64)
            figures = self._figures(predicted, captured, self._seen)
            several = self._cameras if len(self._room.cameras) > 1 else {}
            cameras = {number: self._figures(predicted, captured, pixels) for number, pixels in several.items()}
            inside = self._inside(predicted, captured)
            yield Verified(index, *figures, certificate, unreachable, codes, predicted, captured, cameras, inside)
            target = self.desired - np.where(self._seen[..., None], captured - predicted, 0)

    def _inside(self, predicted: FloatArray, captured: FloatArray) -> Coverage | None:
        if self._interval is None:
            return None
        half_width, white = self._interval.half_width(predicted)[None] / self.white, self.white
        return coverage(half_width, predicted[None] / white, captured[None] / white, self._seen & self._room.mask)

    def _figures(self, predicted: FloatArray, captured: FloatArray, pixels: BoolArray) -> Figures:
        """Returns the figures of some pixels inside the mask."""
        pairs, counts = ((self.desired, predicted), (self.desired, captured), (predicted, captured)), self._room.mask
        found = [camera_psnr(wanted, seen, counts & pixels, self.white) for wanted, seen in pairs]
        return found[0], found[1], found[2]

    def _drive(self, light: FloatArray) -> FloatArray:
        """Returns the drive, 0 to 1, (projector pixels, 3)."""
        drive = self._box.solve(light).drive if self._T_pinv is None else self._T_pinv.apply(light)
        return np.asarray(np.clip(drive, 0, 1).reshape(-1, 3))

    def _arriving(self, codes: Codes) -> FloatArray:
        """Returns the light of rounded code values, at the place where it lands in the calibrated raster."""
        drive = self._room.response.to_linear(codes)
        return self._drift.landed(drive, self._room.regions) if self._drift.moves else drive

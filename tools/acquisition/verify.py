"""The closed loop: show a compensated picture, photograph it, and compare with what was predicted and wanted.

Rounds of feedback take out what T does not know: the prediction's error δ = captured − predicted changes little between
two similar pictures, so that the next round solves T p + e + δ = desired. (Asking for more wherever the capture had too
little would not do: much of that no drive within 0..1 can give, and the rest would suffer.)
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.calibration import StoredCalibration
from counterlight.maps.room_maps import read_maps
from counterlight.pipeline import encoding
from counterlight.pipeline.content import camera_psnr
from counterlight.pipeline.drift import Drift
from counterlight.pipeline.operators import compensation
from counterlight.tools.acquisition.photographer import Photographer
from counterlight.tools.acquisition.plan import Codes
from counterlight.tools.colour.tiers import tier_of
from counterlight.tools.solve.registry import prepare
from counterlight.tools.transport.objective import DEFAULT_AIMS, ObjectiveOptions, objective_of
from counterlight.tools.transport.transport import Transport

MUCH_WORSE = 3.0  # dB: a capture so far below its prediction is worth a word


@dataclass(frozen=True)
class Verified:
    """One round: PSNR in dB of what T predicts, of what was captured, and of the capture against the prediction.

    codes : what was shown.  predicted, captured : (camera height, camera width, 3), screen primaries.
    """

    round: int
    predicted_psnr: float
    measured_psnr: float
    model_psnr: float
    codes: Codes
    predicted: FloatArray
    captured: FloatArray

    def __str__(self) -> str:
        return (
            f"round {self.round}: predicted {self.predicted_psnr:.2f} dB, measured {self.measured_psnr:.2f} dB; the "
            f"capture agrees with the prediction to {self.model_psnr:.2f} dB"
        )

    @property
    def verdict(self) -> str:
        """What a person is to make of it."""
        short = self.predicted_psnr - self.measured_psnr
        if short < MUCH_WORSE:
            return f"the picture arrives as predicted, {self.measured_psnr:.1f} dB"
        return (
            f"the picture arrives {short:.1f} dB worse than predicted: focus, response or colours are not as the "
            "calibration has them; measure them, or acquire again"
        )


class Verification:
    """A picture in a calibrated room.

    transport : the stored calibration's.  drift : what is undone.
    picture : (camera height, camera width, 3), linear 0..1, or the desired camera radiance itself.
    colour : of choices.COLOURS; the solver `map` takes that of the maps.
    desired, and what is predicted and captured, are in screen primaries.
    """

    def __init__(
        self,
        photographer: Photographer,
        stored: StoredCalibration,
        transport: Transport,
        drift: Drift,
        picture: FloatArray,
        *,
        radiance: bool,
        solver: str,
        colour: str = "auto",
        aims: ObjectiveOptions = DEFAULT_AIMS,
    ) -> None:
        ambient = stored.calibration.ambient if drift.ambient is None else drift.ambient
        self._photographer, self._room, self._drift = photographer, replace(stored.calibration, ambient=ambient), drift
        maps = read_maps(stored) if solver == "map" else None
        self._T_pinv = None if maps is None else compensation(maps)
        self.tier = tier_of(self._room, transport, colour if maps is None else maps.mixing.tier)
        self._objective = objective_of(self.tier.transport, self._room, aims)
        self._box = prepare("box", self.tier.transport, self._room.mask, self._objective)
        self.white = self.tier.white * drift.dimming
        self.desired: FloatArray = (
            np.asarray(self.tier.mixing.on_screen(picture), np.float64) if radiance else picture * self.white
        )

    def run(self, rounds: int, repeats: int) -> Iterator[Verified]:
        """The plain compensation, and then `rounds` of feedback.  repeats : captures of each, averaged."""
        target = self.desired
        for index in range(rounds + 1):
            codes = self._codes(target)
            predicted = self.tier.seen(self._arriving(codes))
            captured = np.asarray(self.tier.mixing.on_screen(self._photographer.mean(codes, repeats)), np.float64)
            pairs = (self.desired, predicted), (self.desired, captured), (predicted, captured)
            figures = [camera_psnr(wanted, seen, self._room.mask, self.white) for wanted, seen in pairs]
            yield Verified(index, figures[0], figures[1], figures[2], codes, predicted, captured)
            target = self.desired - (captured - predicted)

    def _codes(self, target: FloatArray) -> Codes:
        asked = self.tier.asked(target)
        light = self._objective.bounded(asked.reshape(-1, 3)).reshape(asked.shape)
        drive = self._box.solve(light).drive if self._T_pinv is None else self._T_pinv.apply(light)
        drive = np.clip(drive, 0, 1).reshape(*self._room.projector.shape, 3)
        shown = self._drift.shown(drive, self._room.regions)
        return encoding.encoded_drive(shown, self._room.response)

    def _arriving(self, codes: Codes) -> FloatArray:
        """What the projector makes of whole code values, where it lands in the calibrated raster."""
        drive = self._room.response.to_linear(codes)
        return self._drift.landed(drive, self._room.regions) if self._drift.moves else drive

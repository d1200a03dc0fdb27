"""The closed loop: show a compensated picture, photograph it, and compare with what was predicted and wanted.

Rounds of feedback take out what T does not know: the prediction's error δ = captured − predicted changes little between
two similar pictures, so that the next round solves T p + e + δ = desired. (Asking for more wherever the capture had too
little would not do: much of that no drive within 0..1 can give, and the rest would suffer.)
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.calibration import Calibration, StoredCalibration
from counterlight.errors import InputError
from counterlight.maps.room_maps import read_maps
from counterlight.pipeline import reference
from counterlight.pipeline.content import camera_psnr
from counterlight.pipeline.operators import compensation
from counterlight.tools.acquisition.cameras.camera import Camera
from counterlight.tools.acquisition.movement import refuse_moved
from counterlight.tools.acquisition.plan import Codes, measure_noise
from counterlight.tools.colour.tiers import tier_of
from counterlight.tools.solve.registry import prepare
from counterlight.tools.transport.objective import DEFAULT_AIMS, ObjectiveOptions, objective_of
from counterlight.tools.transport.storage import read_transport

REFERENCES = 2  # captures of black and of white each
AGAIN = "put them back, or acquire again"


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


class Verification:
    """A picture in a calibrated room.

    picture : (camera height, camera width, 3), linear 0..1, or the desired camera radiance itself.  repeats : captures
    of each round, averaged.  colour : of choices.COLOURS; the solver `map` takes that of the maps.
    desired, and what is predicted and captured, are in screen primaries.
    """

    def __init__(
        self,
        camera: Camera,
        stored: StoredCalibration,
        picture: FloatArray,
        *,
        radiance: bool,
        solver: str,
        colour: str = "auto",
        aims: ObjectiveOptions = DEFAULT_AIMS,
    ) -> None:
        self._camera, self._room = camera, stored.calibration
        transport = read_transport(stored)
        self._rise = transport.composition().reshape(self._room.ambient.shape)
        maps = read_maps(stored) if solver == "map" else None
        self._T_pinv = None if maps is None else compensation(maps)
        self.tier = tier_of(self._room, transport, colour if maps is None else maps.mixing.tier)
        objective = objective_of(self.tier.transport, self._room, aims)
        self._box = prepare("box", self.tier.transport, self._room.mask, objective)
        self.white = self.tier.white
        self.desired: FloatArray = (
            np.asarray(self.tier.mixing.on_screen(picture), np.float64) if radiance else picture * self.white
        )
        self._captures = 0

    def run(self, rounds: int, repeats: int) -> Iterator[Verified]:
        """The plain compensation, and then `rounds` of feedback. InputError if the room is another one."""
        self._refuse_other_room()
        target = self.desired
        for index in range(rounds + 1):
            codes = self._codes(target)
            predicted = self.tier.seen(_drive(codes, self._room))
            captured = np.asarray(
                self.tier.mixing.on_screen(np.mean(self._capture([codes] * repeats), axis=0)), np.float64
            )
            pairs = (self.desired, predicted), (self.desired, captured), (predicted, captured)
            figures = [camera_psnr(wanted, seen, self._room.mask, self.white) for wanted, seen in pairs]
            yield Verified(index, figures[0], figures[1], figures[2], codes, predicted, captured)
            target = self.desired - (captured - predicted)

    def _codes(self, target: FloatArray) -> Codes:
        light = self.tier.asked(target)
        drive = self._box.solve(light).drive if self._T_pinv is None else self._T_pinv.apply(light)
        drive = np.clip(drive, 0, 1).reshape(*self._room.projector.shape, 3)
        return reference.encode(drive, self._room.projector.response.inverse_table())

    def _capture(self, pictures: Sequence[Codes]) -> list[FloatArray]:
        """What the camera sees of each picture, (camera height, camera width, 3), shown one after the other."""
        numbers = range(self._captures, self._captures + len(pictures))
        self._captures = numbers.stop
        self._camera.prepare(numbers.start, pictures, numbers)
        return [self._one(number, codes) for number, codes in zip(numbers, pictures, strict=True)]

    def _one(self, number: int, codes: Codes) -> FloatArray:
        seen = self._camera.exposures.radiance(self._camera.capture(number, codes))
        height, width = self._room.camera.shape
        if seen.shape[:2] != (height, width):
            raise InputError(
                f"the camera gives {seen.shape[1]}x{seen.shape[0]}, the calibration was made with "
                f"{width}x{height}; set the camera to that size"
            )
        return np.asarray(seen, np.float64)

    def _refuse_other_room(self) -> None:
        shape = (*self._room.projector.shape, 3)
        levels = [np.full(shape, level, np.uint8) for level in (0, 255) for _ in range(REFERENCES)]
        captures = self._capture(levels)
        blacks, whites = captures[:REFERENCES], captures[REFERENCES:]
        noise = measure_noise(blacks, whites)
        black, white = np.mean(blacks, axis=0), np.mean(whites, axis=0)
        mask = self._room.mask
        before, after = self._rise[mask], (white - black)[mask]
        refuse_moved(before, after, noise, 2 / REFERENCES, AGAIN)


def _drive(codes: Codes, room: Calibration) -> FloatArray:
    """What the projector makes of whole code values."""
    return room.projector.response.to_linear(codes / 255.0)

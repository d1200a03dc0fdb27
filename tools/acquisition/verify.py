"""The closed loop: show a compensated picture, photograph it, and compare with what was predicted and wanted.

Rounds of feedback take out what T does not know: the prediction's error δ = captured − predicted changes little between
two similar pictures, so that the next round solves T p + e + δ = desired. (Asking for more wherever the capture had too
little would not do: much of that no drive within 0..1 can give, and the rest would suffer.)
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.calibration import Calibration, StoredCalibration
from counterlight.errors import InputError
from counterlight.maps.room_maps import read_maps
from counterlight.pipeline import reference
from counterlight.pipeline.content import camera_psnr, reachable_white
from counterlight.pipeline.operators import compensation
from counterlight.tools.acquisition.cameras.live import LiveCamera
from counterlight.tools.acquisition.movement import refuse_moved
from counterlight.tools.acquisition.plan import Codes, measure_noise
from counterlight.tools.solve.registry import prepare
from counterlight.tools.transport.storage import read_transport

REFERENCES = 2  # captures of black and of white each
AGAIN = "put them back, or acquire again"


@dataclass(frozen=True)
class Verified:
    """One round: PSNR in dB of what T predicts, of what was captured, and of the capture against the prediction.

    codes : what was shown.  predicted, captured : (camera height, camera width, 3), radiance.
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

    picture : (camera height, camera width, 3), linear 0..1, or the desired radiance itself.  repeats : captures of
    each round, averaged.
    """

    def __init__(
        self, camera: LiveCamera, stored: StoredCalibration, picture: FloatArray, *, radiance: bool, solver: str
    ) -> None:
        self._camera, self._room, self._solver = camera, stored.calibration, solver
        self._transport = read_transport(stored)
        self._box = prepare("box", self._transport, self._room.mask)
        self._T_pinv = compensation(read_maps(stored)) if solver == "map" else None
        self._flood = self._transport.floodlight(self._room.ambient)
        self.white = reachable_white(self._flood, self._room.mask)
        self.desired: FloatArray = picture if radiance else picture * self.white
        self._captures = 0

    def run(self, rounds: int, repeats: int) -> Iterator[Verified]:
        """The plain compensation, and then `rounds` of feedback. InputError if the room is another one."""
        self._refuse_other_room()
        target = self.desired
        for index in range(rounds + 1):
            codes = self._codes(target)
            predicted = self._transport.apply(_drive(codes, self._room)) + self._room.ambient
            captured = self._capture(codes, repeats)
            pairs = (self.desired, predicted), (self.desired, captured), (predicted, captured)
            figures = [camera_psnr(wanted, seen, self._room.mask, self.white) for wanted, seen in pairs]
            yield Verified(index, figures[0], figures[1], figures[2], codes, predicted, captured)
            target = self.desired - (captured - predicted)

    def _codes(self, target: FloatArray) -> Codes:
        light = target - self._room.ambient
        drive = self._box.solve(light).drive if self._T_pinv is None else self._T_pinv.apply(light)
        drive = np.clip(drive, 0, 1).reshape(*self._room.projector.shape, 3)
        return reference.encode(drive, self._room.projector.response.inverse_table())

    def _capture(self, codes: Codes, repeats: int) -> FloatArray:
        total = np.zeros((*self._room.camera.shape, 3))
        for _ in range(repeats):
            shots = self._camera.capture(self._captures, codes)
            self._captures += 1
            seen = self._camera.exposures.radiance(shots)
            if seen.shape != total.shape:
                raise InputError(
                    f"the camera gives {seen.shape[1]}x{seen.shape[0]}, the calibration was made with "
                    f"{total.shape[1]}x{total.shape[0]}; set the camera to that size"
                )
            total += seen
        return total / repeats

    def _refuse_other_room(self) -> None:
        shape = (*self._room.projector.shape, 3)
        levels = [np.full(shape, level, np.uint8) for level in (0, 255)]
        pictures = [[self._capture(codes, 1) for _ in range(REFERENCES)] for codes in levels]
        noise = measure_noise(*pictures)
        black, white = (np.mean(each, axis=0) for each in pictures)
        mask = self._room.mask
        before, after = (self._flood - self._room.ambient)[mask], (white - black)[mask]
        refuse_moved(before, after, noise, 2 / REFERENCES, AGAIN)


def _drive(codes: Codes, room: Calibration) -> FloatArray:
    """What the projector makes of whole code values."""
    return room.projector.response.to_linear(codes / 255.0)

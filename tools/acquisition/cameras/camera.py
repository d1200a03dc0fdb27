"""What captures: a small protocol, and how stored code values become radiance.

A camera is told a level of patterns before the first of them is shown (`prepare`), and then asked for one capture after
the other. A capture is a bracket of shots, one for each of the camera's exposures, stored as they come; radiance is
made of them only when they are read (`Exposures.radiance`), so that a better merging can be used on old captures.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray
from counterlight.errors import InputError
from counterlight.response import Response
from counterlight.tools.acquisition.plan import Pattern

Shot: TypeAlias = NDArray[Any]  # (height, width) or (height, width, 3), uint8 or uint16, as stored
SATURATED = 0.98  # of full scale: from here on a sensor no longer rises evenly
LINEAR = Response("linear")


class Camera(Protocol):
    """A camera that looks at the projector's light.

    name : what it is; captures of cameras of different names are never mixed.  exposures : of each capture.
    """

    @property
    def name(self) -> str: ...
    @property
    def exposures(self) -> "Exposures": ...
    def prepare(self, first: int, patterns: Sequence[Pattern], missing: Sequence[int]) -> None:
        """A level begins: its patterns have the numbers first, first + 1, …, of which `missing` will be asked for."""

    def capture(self, number: int, pattern: Pattern) -> tuple[Shot, ...]:
        """Show a pattern and photograph it, once for each exposure."""


@dataclass(frozen=True)
class Exposures:
    """How shots become radiance.

    times : of each shot of a bracket; full scale of a shot is a radiance of 1 / time.
    response : light, 0..1, of a code value.
    """

    times: tuple[float, ...] = (1.0,)
    response: Response = LINEAR

    def __post_init__(self) -> None:
        if not self.times or not all(0 < time < float("inf") for time in self.times):
            raise InputError(f"exposures {self.times}: expected one or more numbers above 0")

    def radiance(self, shots: Sequence[Shot]) -> NDArray[np.float32]:
        """(height, width, 3), the shots weighted by their photons: Σ t L / Σ t² over shots that are not saturated.

        With photon noise the best estimate of radiance is all light over all time. A pixel saturated everywhere has the
        value of the shortest exposure.
        """
        collected, exposed = np.zeros(1), np.zeros(1)
        for shot, time in zip(shots, self.times, strict=True):
            light = self._linear(shot)
            usable = np.asarray(light < self._top)
            collected, exposed = collected + light * usable, exposed + time * usable
        shortest = int(np.argmin(self.times))
        saturated = self.one(shots[shortest], self.times[shortest])
        radiance = np.divide(collected, exposed, out=saturated, where=exposed > 0)
        return np.asarray(radiance, np.float32)

    def saturated(self, shots: Sequence[Shot]) -> NDArray[np.bool_]:
        """(height, width), the shortest exposure is at the top of the camera's range."""
        light = self._linear(shots[int(np.argmin(self.times))])
        return np.asarray(np.any(light >= self._top, axis=2))

    def one(self, shot: Shot, time: float) -> FloatArray:
        """The light of a single shot exposed for `time`, saturated or not: (height, width, 3)."""
        return self._linear(shot) / time

    @property
    def _top(self) -> FloatArray:
        top: FloatArray = self.response.to_linear(np.full(3, SATURATED))
        return top

    def _linear(self, shot: Shot) -> FloatArray:
        codes = shot.astype(np.float64) / np.iinfo(shot.dtype).max
        return self.response.to_linear(np.repeat(codes[..., None], 3, axis=2) if codes.ndim == 2 else codes)

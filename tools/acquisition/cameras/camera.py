"""The camera protocol, and the conversion of stored code values to radiance.

`prepare` passes a level of patterns to the camera before the first is shown; then `capture` requests one capture after
the other. A capture is a bracket of shots, one per exposure, stored unchanged. Radiance is computed only on reading
(`Exposures.radiance`), so that a better merging can be applied to old captures.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray
from counterlight.errors import InputError
from counterlight.response import Response
from counterlight.tools.acquisition.plan import Picture
from counterlight.tools.hdr.camera_response import exposure_table
from counterlight.tools.hdr.estimators import CpuSums, Estimator, make_estimator

Shot: TypeAlias = NDArray[Any]  # (height, width) or (height, width, 3), uint8 or uint16, as the camera gave it
LINEAR = Response("linear")


class Camera(Protocol):
    """A camera that sees the projector's light.

    name : identifies the camera; captures of cameras with different names are never mixed.
    exposures : exposures of each capture.
    """

    @property
    def name(self) -> str: ...
    @property
    def exposures(self) -> "Exposures": ...
    def prepare(self, first: int, patterns: Sequence[Picture], missing: Sequence[int]) -> None:
        """Prepare a level: its patterns have the numbers first, first + 1, …, and `missing` will be captured."""

    def capture(self, number: int, picture: Picture) -> tuple[Shot, ...]:
        """Show a picture and photograph it, once per exposure."""


@dataclass(frozen=True)
class Exposures:
    """How shots become radiance.

    times : exposure of each shot of a bracket; full scale of a shot is a radiance of 1 / time.
    response : code value → light, 0 to 1.
    known : whether the response was given; otherwise an acquisition measures it.
    """

    times: tuple[float, ...] = (1.0,)
    response: Response = LINEAR
    known: bool = True

    def __post_init__(self) -> None:
        if not self.times or not all(0 < time < float("inf") for time in self.times):
            given = ",".join(f"{time:g}" for time in self.times)
            raise InputError(f"--exposures {given}: expected one or more numbers above 0")

    @property
    def shortest(self) -> float:
        """The shortest exposure of the bracket; values that saturate here are lost."""
        return min(self.times)

    def radiance(self, shots: Sequence[Shot]) -> NDArray[np.float32]:
        """Merge unclipped shots to (height, width, 3): total light over total time (hdr/estimators.py, average).

        This is the best estimate under photon noise. A pixel that clips everywhere gets the bound of the shortest
        exposure.
        """
        if len(shots) == len(self.times) == 1:
            table, codes = _radiance_table(self.response, shots[0].dtype, self.times[0]), _coloured(shots[0])
            seen = np.empty(codes.shape, np.float32)
            for i in range(3):
                seen[..., i] = table[i].take(codes[..., i])
            return seen
        estimator = _estimator(self.response, shots[0].dtype)
        sums = CpuSums(estimator, (*shots[0].shape[:2], 3))
        for shot, time in zip(shots, self.times, strict=True):
            sums.add(_coloured(shot), estimator.coefficients(time), time)
        return np.abs(sums.estimate())

    def saturated(self, shots: Sequence[Shot]) -> NDArray[np.bool_]:
        """Returns (height, width) bool: the shortest exposure is at the top of the camera's range."""
        shot = _coloured(shots[self.times.index(self.shortest)])
        return np.asarray(np.any(shot >= _estimator(self.response, shot.dtype).top, axis=2))

    def codes(self, shots: Sequence[Shot]) -> FloatArray:
        """Returns the mean code values of the shortest exposure, 0 to 1: (height, width, 3)."""
        shortest = [shot for shot, time in zip(shots, self.times, strict=True) if time == self.shortest]
        return _coloured(np.mean(shortest, axis=0) / np.iinfo(shots[0].dtype).max)

    def one(self, shot: Shot, time: float) -> FloatArray:
        """Returns the light of a single shot exposed for `time`, clipped or not: (height, width, 3)."""
        return self.response.to_linear(_coloured(shot) / np.iinfo(shot.dtype).max) / time


def _coloured(shot: Shot) -> Shot:
    return np.repeat(shot[..., None], 3, axis=2) if shot.ndim == 2 else shot


@cache
def _estimator(response: Response, dtype: np.dtype[Any]) -> Estimator:
    levels = int(np.iinfo(dtype).max) + 1
    return make_estimator("average", exposure_table(response, levels, 3), np.ones(levels))


@cache
def _radiance_table(response: Response, dtype: np.dtype[Any], time: float) -> NDArray[np.float32]:
    """Returns the radiance per code value for a single shot, (3, levels)."""
    estimator = _estimator(response, dtype)
    codes = np.arange(len(estimator.table), dtype=dtype)[None, :, None]
    sums = CpuSums(estimator, (1, codes.size, 3))
    sums.add(np.repeat(codes, 3, axis=2), estimator.coefficients(time), time)
    return np.ascontiguousarray(np.abs(sums.estimate())[0].T)

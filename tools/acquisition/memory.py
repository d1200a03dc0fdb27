"""Captures kept in memory, for an acquisition that is only simulated."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from counterlight.response import Response
from counterlight.tools.acquisition.cameras.camera import Exposures, Shot


class MemoryStore:
    """The part of CaptureStore that `acquire` needs, without files."""

    halves = coloured = True

    def __init__(self, exposures: Exposures, *, averaged: bool = False) -> None:
        self._exposures, self._kept, self.averaged = exposures, dict[int, Sequence[Shot]](), averaged

    def repeats(self, level: int, choose: Callable[[], int]) -> int:
        return choose()

    def has_curve(self, choose: Callable[[], bool]) -> bool:
        return choose()

    def has_colours(self, number: int, choose: Callable[[], bool]) -> bool:
        return choose()

    def develop(self, response: Response) -> None:
        self._exposures = replace(self._exposures, response=response)

    def has(self, number: int) -> bool:
        return number in self._kept

    def save(self, number: int, shots: Sequence[Shot]) -> None:
        self._kept[number] = shots

    def shots(self, number: int) -> Sequence[Shot]:
        return self._kept[number]

    def size(self, number: int) -> int:
        return 0

    def radiance(self, number: int) -> NDArray[np.float32]:
        return self._exposures.radiance(self._kept[number])

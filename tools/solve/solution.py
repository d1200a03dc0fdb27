"""What every solver returns."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Solution:
    """A projector picture of one colour channel.

    unclamped : (projector pixels,), what the method says.
    notes : what a user should know about how it came about, one sentence each.
    """

    unclamped: FloatArray
    notes: tuple[str, ...] = ()

    @property
    def drive(self) -> FloatArray:
        """(projector pixels,), what a projector can show: clamped to 0..1."""
        return np.clip(self.unclamped, 0.0, 1.0)

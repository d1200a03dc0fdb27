"""Distance of a picture from the best picture: the data for an estimate, and its result (survey.py)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from counterlight.pipeline.refinement import Certificate


@dataclass(frozen=True)
class Snapshot:
    """A drive and its descent, read back from the device. Pictures are (projector height, projector width, 3).

    drive, ahead : p and y.
    descent : TᵀW (b − T p), with the target b of the steps.
    unweighted : Tᵀ (b − T p) over the lit camera pixels, with unlimited b.
    made : steps since the last cut.
    steps : steps of this frame, included in `made`.
    """

    certificate: Certificate
    drive: NDArray[np.float32]
    ahead: NDArray[np.float32]
    descent: NDArray[np.float32]
    unweighted: NDArray[np.float32]
    made: int
    steps: int


@dataclass(frozen=True)
class Shortfall:
    """An estimate of how far a picture is below the best picture.

    decibels : dB below the unweighted optimum over the lit camera pixels.
    doubling : dB that as many further steps, and at least one step, would gain.
    steps : steps of the picture.
    solved, squares : number of squares that were solved, and of all squares.
    spread : relative standard error of a sample.
    """

    decibels: float
    doubling: float
    steps: int
    solved: int
    squares: int
    spread: float = 0.0

    @property
    def further(self) -> int:
        """Number of further steps that `doubling` refers to."""
        return max(self.steps, 1)

    @property
    def method(self) -> str:
        """The method of the estimate, in words."""
        if self.solved == self.squares:
            return f"estimated: all {self.squares} squares solved to the end"
        return f"estimated: {self.solved} of {self.squares} squares solved to the end, ±{100 * self.spread:.0f} %"

    def __str__(self) -> str:
        return f"{self.decibels:.2g} dB below the optimum ({self.method})"

    def to_dict(self) -> dict[str, float | int]:
        """Return values for JSON."""
        return {
            "below_optimum_db": round(self.decibels, 5),
            "next_doubling_db": round(self.doubling, 5),
            "squares_solved": self.solved,
            "squares": self.squares,
            "relative_spread": round(self.spread, 3),
        }

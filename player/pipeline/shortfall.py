"""Where a picture stands below the best one: what is read back to find out, and the estimate (survey.py)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from counterlight.pipeline.refinement import Certificate


@dataclass(frozen=True)
class Snapshot:
    """A drive and its descent, read back from the device; pictures are (projector height, projector width, 3).

    drive, ahead, descent : p, y and TᵀW (b − T p) of the b that steps seek.
    unweighted : Tᵀ (b − T p) over the lit camera pixels, of all b that was asked for.
    made : steps since the last cut that led there.  steps : of them, those of this frame.
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
    """An estimate of where a picture stands.

    decibels : below the unweighted optimum over the lit camera pixels.  doubling : decibels that as many steps again,
    or one where there were none, would bring this picture.  steps : it was made with.
    solved, squares : how many were solved, of how many.  spread : standard error of a sample, relative.
    """

    decibels: float
    doubling: float
    steps: int
    solved: int
    squares: int
    spread: float = 0.0

    @property
    def further(self) -> int:
        """The steps of a doubling."""
        return max(self.steps, 1)

    @property
    def method(self) -> str:
        """How it was found."""
        if self.solved == self.squares:
            return f"estimated: all {self.squares} squares solved to the end"
        return f"estimated: {self.solved} of {self.squares} squares solved to the end, ±{100 * self.spread:.0f} %"

    def __str__(self) -> str:
        return f"{self.decibels:.2g} dB below the optimum ({self.method})"

    def to_dict(self) -> dict[str, float | int]:
        """For JSON."""
        return {
            "below_optimum_db": round(self.decibels, 5),
            "next_doubling_db": round(self.doubling, 5),
            "squares_solved": self.solved,
            "squares": self.squares,
            "relative_spread": round(self.spread, 3),
        }

"""The prior on the drive of hardly seen pixels: ½ Σ η p² + ½ Σ ω (p_j − p_k)² over neighbours j, k, per channel.

Its matrix P has η + Σ ω on the diagonal and −ω off the diagonal. `pull` applies it, as refinement_step.frag does.
docs/mathematics.md 2 derives η and ω.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import brief
from counterlight.errors import InputError
from counterlight.files import exr
from counterlight.files.reading import DescribedFiles

Picture = NDArray[np.float32]


@dataclass(frozen=True)
class Prior:
    """Weights of the prior, (projector height, projector width, 3) each, ≥ 0.

    damping : η, towards darkness.
    right, down : ω of the tie to the right and lower neighbour; 0 without a tie.
    """

    damping: Picture
    right: Picture
    down: Picture

    __repr__ = brief

    @property
    def bound(self) -> Picture:
        """Row sums of |P|, η + 2 Σ ω. They bound P: P ≼ diag(bound), and no eigenvalue of P exceeds the largest sum."""
        edges = self.right + self.down
        edges[:, 1:] += self.right[:, :-1]
        edges[1:] += self.down[:-1]
        return np.asarray(self.damping + 2 * edges, np.float32)

    @classmethod
    def none(cls, shape: tuple[int, int]) -> "Prior":
        """Return a prior with all weights 0."""
        return cls(*(np.zeros((*shape, 3), np.float32) for _ in range(3)))

    def check(self, where: Callable[[str], str], fix: str) -> None:
        """Raise InputError for values below 0 or not finite, or ties beyond the edge. where : name -> file."""
        for name in NAMES:
            values = getattr(self, name)
            if not (np.isfinite(values).all() and values.min() >= 0):
                raise InputError(f"{where(name)}: holds NaN, infinity or a negative weight; {fix}")
        for name, last in (("right", self.right[:, -1]), ("down", self.down[-1])):
            if last.any():
                raise InputError(f"{where(name)}: ties pixels to some beyond the picture's edge; {fix}")

    def write(self, folder: Path) -> None:
        for name in NAMES:
            exr.write_plain(folder / file_of(name), exr.rgb(getattr(self, name)))


NAMES = tuple(field.name for field in fields(Prior))


def file_of(name: str) -> str:
    """Return the file name of one of the prior's pictures in correction/."""
    return f"prior_{name}.exr"


def read(files: DescribedFiles, projector: tuple[int, int]) -> Prior:
    """Read the prior in a folder of maps; raises InputError if it does not fit the projector, or is damaged."""
    prior = Prior(*(exr.read_described(files, file_of(name), projector, "the projector") for name in NAMES))
    prior.check(lambda name: f"{files.folder / file_of(name)}", files.fix)
    return prior


def pull(
    p: NDArray[np.floating],
    damping: NDArray[np.floating],
    right: NDArray[np.floating],
    down: NDArray[np.floating],
) -> NDArray[np.floating]:
    """Return P p of a prior: η p + Σ ω (p − p of the neighbour)."""
    across, along = right[:, :-1] * np.diff(p, axis=1), down[:-1] * np.diff(p, axis=0)
    result = np.asarray(damping * p)
    result[:, :-1] -= across
    result[:, 1:] += across
    result[:-1] -= along
    result[1:] += along
    return result

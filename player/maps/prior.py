"""What a drive is drawn to where the camera says little: ½ Σ η p² + ½ Σ ω (p_j − p_k)² over neighbours j, k, a channel.

P, its matrix, has η + Σ ω on the diagonal and −ω beside it; pipeline/reference.py applies it (`pull`), as
refinement_step.frag does. docs/mathematics.md 2 says where η and ω come from.
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
    """All (projector height, projector width, 3), ≥ 0.

    damping : η, towards darkness.  right, down : ω between a pixel and the one on its right, or below; 0 where none is.
    """

    damping: Picture
    right: Picture
    down: Picture

    __repr__ = brief

    @property
    def bound(self) -> Picture:
        """Row sums of |P|, η + 2 Σ ω: no eigenvalue of P is above the largest, and P ≼ diag of them."""
        edges = self.right + self.down
        edges[:, 1:] += self.right[:, :-1]
        edges[1:] += self.down[:-1]
        return np.asarray(self.damping + 2 * edges, np.float32)

    @classmethod
    def none(cls, shape: tuple[int, int]) -> "Prior":
        """Which draws nowhere."""
        return cls(*(np.zeros((*shape, 3), np.float32) for _ in range(3)))

    def check(self, where: Callable[[str], str], fix: str) -> None:
        """InputError for what is not finite, below 0, or an edge that leaves the picture. where : name -> its file."""
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
    """One of the prior's pictures in correction/."""
    return f"prior_{name}.exr"


def read(files: DescribedFiles, projector: tuple[int, int]) -> Prior:
    """The prior in a folder of maps; InputError if it does not fit the projector, or is damaged."""
    prior = Prior(*(exr.read_described(files, file_of(name), projector, "the projector") for name in NAMES))
    prior.check(lambda name: f"{files.folder / file_of(name)}", files.fix)
    return prior

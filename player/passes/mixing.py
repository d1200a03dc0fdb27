"""Matrices applied to the channels of a picture (counterlight.maps.mixing)."""

from dataclasses import dataclass

import numpy as np

from counterlight.maps.mixing import mixed
from counterlight.passes.drawing import Array, Numbers, Pass, Picture, Rows


@dataclass(frozen=True, eq=False)
class Mix(Pass[Picture]):
    """matrix · light + base, with a matrix per pixel."""

    shader = "mix.frag"
    light: Picture
    base: Picture
    rows: Rows[Picture]

    def fill(self: "Mix[Array]", out: Array) -> None:
        out[...] = mixed(stacked(self.rows), self.light) + self.base


@dataclass(frozen=True, eq=False)
class Recolour(Pass[Picture]):
    """matrix · picture, with one matrix for all pixels. matrix : (9,), by columns."""

    shader = "recolour.frag"
    picture: Picture
    matrix: Numbers

    def fill(self: "Recolour[Array]", out: Array) -> None:
        out[...] = self.picture @ np.reshape(self.matrix, (3, 3))


def stacked(rows: Rows[Array]) -> Array:
    """Return the matrices, (height, width, 3, 3)."""
    return np.stack([rows.row_red, rows.row_green, rows.row_blue], axis=-2)

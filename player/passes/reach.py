"""The brightest grey that each primary lets a camera pixel show, and the pixels that count."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from counterlight.maps.mixing import grey_reach
from counterlight.passes.drawing import Array, Pass, Picture, Rows
from counterlight.passes.mixing import stacked


@dataclass(frozen=True, eq=False)
class Reach(Pass[Picture]):
    """The brightest grey per primary.

    The fourth channel is 1 for pixels inside the mask that are lit in every channel, else 0.

    seen : light of full drive; with `mixed`, without ambient light.
    ambient : light without drive.
    mixed : rows of a matrix per pixel, by which grey is mixed.
    unlimited : with `mixed`, the grey where a primary is not needed.
    """

    shader = "reach.frag"
    channels = 4
    seen: Picture
    ambient: Picture
    mask: Picture
    mixed: Rows[Picture] | None = None
    unlimited: float | None = None

    def fill(self: "Reach[Array]", out: Array) -> None:
        seen, ambient, mask = self.seen, self.ambient, self.mask > 0
        if self.mixed is not None:
            reach = grey_reach(stacked(self.mixed), seen, ambient)
            out[...] = counted(reach, mask & np.all(seen > 0, axis=2))
        else:
            out[...] = counted(seen, mask & np.all(seen > ambient, axis=2))


def counted(reach: NDArray[np.floating], counts: NDArray[np.bool_]) -> NDArray[np.floating]:
    """Append a channel to the greys: 1 for pixels that count."""
    return np.concatenate([reach, counts[..., None]], axis=2)

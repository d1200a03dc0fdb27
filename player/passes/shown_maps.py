"""Maps of what a room cannot show, drawn instead of a view or over it (pipeline/views.py); and the split view."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from counterlight.passes.drawing import Array, Numbers, Pass, Picture

BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class ErrorMap(Pass[Picture]):
    """The difference between predicted picture and target, of the worst channel, as a colour.

    b : target of the projector's light.
    reach : output of `Reach`.
    colours : (1, samples, 3). Linear light over errors from −span to span, in shares of white.
    uncounted : (3,). Colour of pixels that do not count.
    """

    shader = "error_map.frag"
    seen: Picture
    b: Picture
    ambient: Picture
    reach: Picture
    colours: Picture
    white: float
    span: float
    uncounted: Numbers

    def fill(self: "ErrorMap[Array]", out: Array) -> None:
        error = (self.seen - self.ambient - self.b) / self.white
        rows, columns = np.indices(error.shape[:2])
        worst = error[rows, columns, np.argmax(np.abs(error), axis=2)]
        position = (np.clip(worst / self.span, -1, 1) + 1) / 2
        colours = self.colours[0]
        grid = np.linspace(0, 1, len(colours))
        light = np.stack([np.interp(position, grid, colours[:, i]) for i in range(3)], axis=-1)
        out[...] = self.white * np.where(self.reach[..., 3:] > 0, light, self.uncounted)


@dataclass(frozen=True, eq=False)
class Impossible(Pass[Picture]):
    """Camera pixels, coloured by the grey that they cannot show.

    reach : output of `Reach`.
    colours : (1, 4, 3). Linear light: everything is possible, the pixel does not count, below mid grey, below white.
    white, mid_grey : radiance.
    slack : relative tolerance.
    """

    shader = "impossible.frag"
    reach: Picture
    colours: Picture
    white: float
    mid_grey: float
    slack: float

    def fill(self: "Impossible[Array]", out: Array) -> None:
        short = np.stack(shortfalls(self.reach, self.white, self.mid_grey, self.slack))
        out[...] = self.white * self.colours[0][np.where(short.any(axis=0), 1 + short.argmax(axis=0), 0)]


def shortfalls(
    reach: NDArray[np.floating], white: float, mid_grey: float, slack: float
) -> tuple[BoolArray, BoolArray, BoolArray]:
    """Return pixels that do not count, cannot reach mid grey, or cannot reach white: (height, width) each."""
    least, lit = reach[..., :3].min(axis=2) * (1 + slack), reach[..., 3] > 0
    return ~lit, lit & (least < mid_grey), lit & (least < white)


@dataclass(frozen=True, eq=False)
class Clipping(Pass[Picture]):
    """A view, coloured where its target is below 0 or above `most`, by the excess of the worst channel.

    most : as `Reach`; None for a limit of 1, with every pixel counted.
    white : light of the colours; excess is measured in shares of white.
    faint, full : excess of half and of full strength.
    above, below : (3,). Colours.
    """

    shader = "clipping.frag"
    view: Picture
    asked: Picture
    white: float
    faint: float
    full: float
    above: Numbers
    below: Numbers
    most: Picture | None = None

    def fill(self: "Clipping[Array]", out: Array) -> None:
        most = np.ones(4) if self.most is None else self.most
        over = np.max(self.asked - most[..., :3], axis=2, keepdims=True) / self.white
        under = np.max(-self.asked, axis=2, keepdims=True) / self.white
        amount = np.where(most[..., 3:] > 0, np.maximum(np.maximum(over, under), 0), 0)
        weight = 0.5 * np.minimum(amount / self.faint, 1) + 0.5 * np.minimum(amount / self.full, 1)
        colour = self.white * np.where(over >= under, self.above, self.below)
        out[...] = self.view + weight * (colour - self.view)


@dataclass(frozen=True, eq=False)
class Split(Pass[Picture]):
    """The left half of one picture and the right half of another. line : light of the line between them."""

    shader = "split.frag"
    left: Picture
    right: Picture
    line: float

    def fill(self: "Split[Array]", out: Array) -> None:
        middle = out.shape[1] // 2
        out[:, :middle], out[:, middle:] = self.left[:, :middle], self.right[:, middle:]
        out[:, middle] = self.line

"""The light that the projector must add, and the picture that is shown without compensation."""

from dataclasses import dataclass
from typing import Any, Generic

import numpy as np

from counterlight.maps.mixing import SWEEPS
from counterlight.passes.drawing import NOTHING, Array, Numbers, Pass, Picture, Rows, given
from counterlight.passes.kernel import LINE, PICTURE, inlined, kernel, prange, within

NO_SQUARES = np.zeros(0, np.float32)


@dataclass(frozen=True, eq=False)
class Tone(Generic[Picture]):
    """Replaces a picture u by s (k + (1 − k) unit · u) + o; see pipeline/content.py.

    tone : (1, 1). (s, o) of the frame.
    unit : share of white that a picture's 1 stands for.
    black_level : k, share of white that black stands for.
    """

    tone: Picture
    unit: float = 1.0
    black_level: float = 0.0


@dataclass(frozen=True, eq=False)
class Desired(Pass[Picture]):
    """b = white · picture · weights − e (thesis eq. 5.1; weights are 1 without `weights`).

    white : light of a picture's 1, or of white with a tone.
    tone : applied to the picture.
    full : T·1. Limits each pixel to its own range; otherwise its neighbours would brighten, and could not help.
    clamp : limit the result to 0..1, for a picture that is sent to the projector.
    mixed : rows of a matrix per pixel, applied to b.
    squares : (9,). With `mixed` and `full`, choose the light that the camera sees nearest to the target
        (maps/mixing.py).
    weights : of the picture's size. 1 / g for a room whose light has changed by factors g (pipeline/correction.py).
    """

    shader = "desired.frag"
    picture: Picture
    ambient: Picture
    white: float
    tone: Tone[Picture] | None = None
    full: Picture | None = None
    clamp: bool = False
    mixed: Rows[Picture] | None = None
    squares: Numbers | None = None
    weights: Picture | None = None

    def fill(self: "Desired[Array]", out: Array) -> None:
        gain, lift = np.float32(self.white), np.float32(0)
        if (toned := self.tone) is not None:
            scale, offset = (float(value) for value in np.ravel(toned.tone)[:2])
            gain = np.float32(self.white * scale * (1 - toned.black_level) * toned.unit)
            lift = np.float32(self.white * (scale * toned.black_level + offset))
        m = self.mixed
        rows = (NOTHING, NOTHING, NOTHING) if m is None else (m.row_red, m.row_green, m.row_blue)
        squares = NO_SQUARES if self.squares is None else np.asarray(self.squares, np.float32)
        limits = self.clamp, given(self.full), squares
        desired(self.picture, self.ambient, gain, lift, given(self.weights), *rows, *limits, out)


@inlined
def _turned(row: Any, squares: Any) -> Any:
    """Return Q Qᵀ times a row of A (maps/mixing.py)."""
    return (
        squares[0] * row[0] + squares[1] * row[1] + squares[2] * row[2],
        squares[3] * row[0] + squares[4] * row[1] + squares[5] * row[2],
        squares[6] * row[0] + squares[7] * row[1] + squares[8] * row[2],
    )


@inlined
def _dot(first: Any, second: Any) -> Any:
    return first[0] * second[0] + first[1] * second[1] + first[2] * second[2]


@inlined
def _more(light: Any, moved: Any, own: Any, most: Any) -> Any:
    """Return the additional change that a primary's limit requires, divided by N's diagonal (maps/mixing.py)."""
    alone = light - own * moved
    return (within(alone, np.float32(0), most) - alone) / own - moved


@inlined
def _nearest(red: Any, green: Any, blue: Any, most: Any, rows: Any, squares: Any) -> Any:
    """Return the light within the limits that the camera sees nearest to the target; see maps/mixing.py."""
    red_turned, green_turned = _turned(rows[0], squares), _turned(rows[1], squares)
    rr, rg, rb = _dot(rows[0], red_turned), _dot(rows[1], red_turned), _dot(rows[2], red_turned)
    gg, gb, bb = _dot(rows[1], green_turned), _dot(rows[2], green_turned), _dot(rows[2], _turned(rows[2], squares))
    of_red, of_green, of_blue = np.float32(0), np.float32(0), np.float32(0)
    for _ in range(SWEEPS):
        more = _more(red, of_red, rr, most[0])
        red, green, blue, of_red = red + rr * more, green + rg * more, blue + rb * more, of_red + more
        more = _more(green, of_green, gg, most[1])
        red, green, blue, of_green = red + rg * more, green + gg * more, blue + gb * more, of_green + more
        more = _more(blue, of_blue, bb, most[2])
        red, green, blue, of_blue = red + rb * more, green + gb * more, blue + bb * more, of_blue + more
    return red, green, blue


@kernel(
    f"{PICTURE}, {PICTURE}, float32, float32, {PICTURE}, {PICTURE}, {PICTURE}, {PICTURE}, boolean, {PICTURE}, {LINE}, "
    f"{PICTURE}"
)
def desired(
    picture: Array,
    ambient: Array,
    gain: Any,
    offset: Any,
    weights: Array,
    row_red: Array,
    row_green: Array,
    row_blue: Array,
    clamp: Any,
    full: Array,
    squares: Array,
    out: Array,
) -> None:
    """Compute b = (gain · picture + offset) · weights − ambient (desired_light), apply a matrix, and limit the result.

    weights, row_red, row_green, row_blue, full, squares : empty arrays switch the weights, matrix or limits off.
    """
    weighs, mixes, limits, makes_up = weights.size > 0, row_red.size > 0, full.size > 0, squares.size > 0
    zero, one = np.float32(0), np.float32(1)
    for y in prange(out.shape[0]):
        for x in range(out.shape[1]):
            red = gain * picture[y, x, 0] + offset
            green = gain * picture[y, x, 1] + offset
            blue = gain * picture[y, x, 2] + offset
            if weighs:
                red, green, blue = red * weights[y, x, 0], green * weights[y, x, 1], blue * weights[y, x, 2]
            red, green, blue = red - ambient[y, x, 0], green - ambient[y, x, 1], blue - ambient[y, x, 2]
            if mixes:
                red, green, blue = (
                    row_red[y, x, 0] * red + row_red[y, x, 1] * green + row_red[y, x, 2] * blue,
                    row_green[y, x, 0] * red + row_green[y, x, 1] * green + row_green[y, x, 2] * blue,
                    row_blue[y, x, 0] * red + row_blue[y, x, 1] * green + row_blue[y, x, 2] * blue,
                )
                if makes_up and (
                    min(red, green, blue) < zero or red > full[y, x, 0] or green > full[y, x, 1] or blue > full[y, x, 2]
                ):
                    rows = row_red[y, x], row_green[y, x], row_blue[y, x]
                    red, green, blue = _nearest(red, green, blue, full[y, x], rows, squares)
            if limits:
                red = within(red, zero, full[y, x, 0])
                green = within(green, zero, full[y, x, 1])
                blue = within(blue, zero, full[y, x, 2])
            if clamp:
                red, green, blue = within(red, zero, one), within(green, zero, one), within(blue, zero, one)
            out[y, x, 0], out[y, x, 1], out[y, x, 2] = red, green, blue

"""Test cards at the projector's size, in linear drive, for setting up a projector. They are sent without compensation.

grid : squares, circles that must look round, a red frame of the outermost pixels, and corner marks; shows lost edges.
focus : a Siemens star in the middle and in each corner, and line pairs of 1, 2, 3 and 4 pixels.
grey : eleven steps of equal sRGB code, rising at the top and falling at the bottom; between them the five codes nearest
    to black and to white.
bars : white, the six colours and black, at full drive in the upper part and at three quarters of the code below.
white, black : full drive and no drive; black shows the light that the projector leaks.
gamma : lines that are on for 1/4, 1/2 and 3/4 of the rows, next to an even field of the same light; white, red, green
    and blue. From a distance both look equal if the projector's response is as calibrated.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from counterlight.response import Response

Card = NDArray[np.float64]

STEPS, NEAR_ENDS = 11, 5  # grey steps; number of codes nearest to black and to white
SQUARES = 12  # squares along the shorter side
SPOKES = 36
LINE_PAIRS = (1, 2, 3, 4)
BARS = ((1, 1, 1), (1, 1, 0), (0, 1, 1), (0, 1, 0), (1, 0, 1), (1, 0, 0), (0, 0, 1), (0, 0, 0))
SHARES = (1, 2, 3)  # lit rows out of four, for each line pattern
TINTS = ((1, 1, 1), (1, 0, 0), (0, 1, 0), (0, 0, 1))
BACKGROUND = 0.5  # sRGB code, 0 to 1
LINE = 0.002  # half of a line's width, relative to the shorter side; at least LEAST_LINE pixels
LEAST_LINE = 0.5


def card(name: str, shape: tuple[int, int]) -> NDArray[np.float32]:
    """Draw one of CARDS for a projector (height, width): linear drive, (height, width, 3)."""
    return np.clip(_DRAWN[name](*shape), 0, 1).astype(np.float32)


def _grid(height: int, width: int) -> Card:
    x, y, short = *_centred(height, width), min(height, width)
    half = max(LINE * short, LEAST_LINE)
    spacing = short / SQUARES
    lines = np.maximum(*(_stroke(_to_nearest(axis, spacing), half) for axis in (x, y)))
    radius = np.hypot(x, y)
    circles = _stroke(radius - 0.45 * short, 2 * half)
    for corner_x, corner_y in _corners(width, height, spacing * 1.5):
        circles = np.maximum(circles, _stroke(np.hypot(x - corner_x, y - corner_y) - spacing, half))
    cross = np.maximum(_stroke(x, half), _stroke(y, half)) * (radius < spacing)
    code = np.maximum(0.35 * lines, np.maximum(circles, cross))
    picture = _light(np.repeat(code[..., None], 3, axis=2))
    edge = np.minimum(width / 2 - np.abs(x), height / 2 - np.abs(y))  # 0.5 in the outermost pixels
    picture[edge < 1] = (1, 0, 0)
    for corner_x, corner_y in _corners(width, height, 0):
        arm = np.maximum(np.abs(x - corner_x), np.abs(y - corner_y)) < spacing
        thin = np.minimum(np.abs(x - corner_x), np.abs(y - corner_y)) < max(2 * half, 2)
        picture[arm & thin] = (1, 1, 1)
    return picture


def _focus(height: int, width: int) -> Card:
    x, y, short = *_centred(height, width), min(height, width)
    card = np.full((height, width), float(_light(np.array(BACKGROUND))))
    for corner_x, corner_y in _corners(width, height, 0.17 * short):
        _put_star(card, x - corner_x, y - corner_y, 0.15 * short)
    _put_star(card, x, y, 0.26 * short)
    patch = max(int(0.1 * short), 1)
    top = max((height - 2 * patch) // 2, 0)
    for i, pair in enumerate(LINE_PAIRS):
        row, column = np.mgrid[: 2 * patch, :patch]
        stripes = np.where(row < patch, column // pair, row // pair) % 2
        for left in (i * patch, width - (i + 1) * patch):
            if 0.3 * short < abs(left + patch / 2 - width / 2) and left >= 0:
                space = card[top : top + 2 * patch, left : left + patch]
                space[...] = stripes[: space.shape[0], : space.shape[1]]
    return np.repeat(card[..., None], 3, axis=2)


def _put_star(card: Card, x: Card, y: Card, radius: float) -> None:
    distance = np.hypot(x, y)
    # The edges of the spokes are softened over a pixel, so that the centre turns grey instead of moiré.
    wave = np.sin(SPOKES * np.arctan2(y, x)) * np.maximum(distance, 1e-9) / SPOKES
    inside = distance < radius
    card[inside] = np.clip(0.5 + wave, 0, 1)[inside]


def _grey(height: int, width: int) -> Card:
    column = np.arange(width) / width
    steps = np.floor(column * STEPS) / (STEPS - 1)
    near = np.floor(column * 2 * NEAR_ENDS)
    ends = np.where(near < NEAR_ENDS, near, 255 - 2 * NEAR_ENDS + 1 + near) / 255
    row = np.arange(height)[:, None] / height
    return _grey_of(np.where(row < 0.4, steps, np.where(row < 0.6, ends, steps[::-1])))


def _bars(height: int, width: int) -> Card:
    colours = np.array(BARS, float)[np.arange(width) * len(BARS) // width]
    lower = np.arange(height)[:, None, None] * 4 >= 3 * height
    return _light(np.where(lower, 0.75, 1.0) * colours)


def _gamma(height: int, width: int) -> Card:
    row, column = np.mgrid[:height, :width]
    cell = np.minimum(column * 2 * len(SHARES) // width, 2 * len(SHARES) - 1)
    share = np.array(SHARES)[cell // 2]
    light = np.where(cell % 2 == 0, row % 4 < share, share / 4)
    tint = np.array(TINTS, float)[np.minimum(row * len(TINTS) // height, len(TINTS) - 1)]
    return np.asarray(light[..., None] * tint)


def _even(drive: float) -> Callable[[int, int], Card]:
    return lambda height, width: np.full((height, width, 3), drive)


def _grey_of(codes: Card) -> Card:
    return _light(np.repeat(codes[..., None], 3, axis=2))


def _light(codes: Card) -> Card:
    return Response("srgb").to_linear(codes)


def _centred(height: int, width: int) -> tuple[Card, Card]:
    """Return x and y of the pixel centres relative to the middle, (height, width) each."""
    y, x = np.mgrid[:height, :width].astype(float)
    return x - (width - 1) / 2, y - (height - 1) / 2


def _corners(width: int, height: int, inset: float) -> list[tuple[float, float]]:
    return [(sx * (width / 2 - inset), sy * (height / 2 - inset)) for sx in (-1, 1) for sy in (-1, 1)]


def _to_nearest(position: Card, spacing: float) -> Card:
    """Return the distance to the nearest multiple of `spacing`."""
    return np.asarray(position - spacing * np.round(position / spacing))


def _stroke(distance: Card, half_width: float) -> Card:
    """Return the coverage of a line by distance, softened over a pixel."""
    return np.clip(half_width + 0.5 - np.abs(distance), 0, 1)


_DRAWN: dict[str, Callable[[int, int], Card]] = {
    "grid": _grid,
    "focus": _focus,
    "grey": _grey,
    "bars": _bars,
    "white": _even(1.0),
    "black": _even(0.0),
    "gamma": _gamma,
}
CARDS = tuple(_DRAWN)

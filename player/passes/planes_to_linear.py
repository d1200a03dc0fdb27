"""Decoded planes to an upright linear picture on the room's screen."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from counterlight.files.cube import Cube
from counterlight.media.frames import PixelFormat
from counterlight.passes.colour import LUMINANCE, LUMINANCE_2020, Decoding
from counterlight.passes.drawing import CHANNELS, Array
from counterlight.passes.kernel import LINE, PLANE, Whole, inlined, kernel, looked_up, prange, within

SHADER = "planes_to_linear.frag"
LEAST = 1e-6  # smallest denominator, which avoids division by 0
ZERO, ONE, SMALL = np.float32(0), np.float32(1), np.float32(LEAST)
RED, GREEN, BLUE = (np.float32(weight) for weight in LUMINANCE)
RED_2020, GREEN_2020, BLUE_2020 = (np.float32(weight) for weight in LUMINANCE_2020)
AS_IT_IS = np.array([0, 1], np.float32)  # a transfer table that changes nothing


@dataclass(frozen=True, eq=False)
class Rendition:
    """The conversion of a picture's light after its transfer curve (pipeline/signal.py).

    ootf : γ − 1 of HLG; 0 for other transfers.
    top : light of the medium's peak; brighter light is treated as equal to it.
    gain : (samples,). Factor of the light, at equal steps of ⁴√(light / top) from 0 to 1.
    matrix : (3, 3). From the medium's primaries to the screen's.
    """

    ootf: float
    top: float
    gain: NDArray[np.float32]
    matrix: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Signal:
    """The path from a medium's codes to light (pipeline/signal.py).

    decoding : decoding of the samples.
    lift : added to every code.
    lut : table applied to codes within 0..1 before the transfer; None for none.
    transfer : (samples,). Light at equal steps of the code from 0 to 1.
    rendition : conversion of the light; None if the light is the screen's own.
    """

    decoding: Decoding
    lift: float
    lut: Cube | None
    transfer: NDArray[np.float32]
    rendition: Rendition | None


class PlanesToLinear:
    """Converts planes of one pixel format. signal : None for linear radiance, which is copied."""

    def __init__(self, pixels: PixelFormat, signal: Signal | None) -> None:
        self._pixels, self._signal = pixels, signal
        if signal is None:
            return
        decoding, lut, rendition = signal.decoding, signal.lut, signal.rendition
        luma, chroma = pixels.planes[:2]
        (right, below), (left, above) = decoding.subsampling, decoding.chroma_offset
        matrix = decoding.to_rgb / decoding.span
        self._decoding = (
            *_samples(luma.height, chroma.height, below, above),
            *_samples(luma.width, chroma.width, right, left),
            matrix.astype(np.float32),
            (signal.lift - matrix @ decoding.black).astype(np.float32),
            signal.transfer if lut is None else AS_IT_IS,
        )
        if lut is not None:
            scale = (len(lut.table) - 1) / (lut.high - lut.low)
            self._cube = lut.table, lut.low.astype(np.float32), scale.astype(np.float32), signal.transfer
        if rendition is not None:
            numbers = np.float32(rendition.ootf), np.float32(rendition.top)
            self._rendition = *numbers, rendition.gain, rendition.matrix.astype(np.float32)

    def fill(self, planes: Sequence[NDArray[Any]], upright: Array) -> None:
        """Convert three planes, (rows, stride) each. upright : (height, width, 3) as the picture is shown."""
        stored = np.rot90(upright, -(self._pixels.rotation // 90))
        if self._signal is None:
            for i, plane in enumerate(planes):
                stored[..., i] = plane[: self._pixels.height, : self._pixels.width]
            return
        pixels = upright.reshape(-1, CHANNELS)
        decode(*planes, *self._decoding, *_walk(upright, stored), pixels)
        if self._signal.lut is not None:
            through_table(pixels, *self._cube)
        if self._signal.rendition is not None:
            on_screen(pixels, *self._rendition)


def planes_to_linear(planes: Sequence[NDArray[Any]], pixels: PixelFormat, signal: Signal | None) -> Array:
    """Return decoded planes as linear RGB, upright, as the player converts them."""
    size = pixels.height, pixels.width
    upright = np.zeros((*(size[::-1] if pixels.rotation % 180 else size), CHANNELS), np.float32)
    PlanesToLinear(pixels, signal).fill([np.ascontiguousarray(plane) for plane in planes], upright)
    return upright


def _walk(upright: Array, stored: Array) -> tuple[int, int, int]:
    """Return the index of a view's first pixel within the upright picture, and the index steps right and down."""
    address = [each.__array_interface__["data"][0] for each in (upright, stored)]
    pixel = upright.strides[1]
    return (address[1] - address[0]) // pixel, stored.strides[1] // pixel, stored.strides[0] // pixel


def _samples(length: int, count: int, every: int, offset: float) -> tuple[Whole, Array]:
    """Return the chroma samples on either side of each pixel, (2, length), and the second's weight, (length,)."""
    position = np.arange(length) / every + offset
    low = np.floor(position)
    return np.clip([low, low + 1], 0, count - 1).astype(np.uint32), (position - low).astype(np.float32)


@inlined
def _between(first: Any, second: Any, share: Any) -> Any:
    return np.float32(first) + (np.float32(second) - np.float32(first)) * share


@kernel(
    *(
        f"{plane}, {plane}, {plane}, uint32[:, ::1], {LINE}, uint32[:, ::1], {LINE}, {PLANE}, {LINE}, {LINE}, "
        f"int64, int64, int64, {PLANE}"
        for plane in ("uint8[:, ::1]", "uint16[:, ::1]")
    )
)
def decode(
    luma: Whole,
    blue: Whole,
    red: Whole,
    rows: Whole,
    down: Array,
    columns: Whole,
    across: Array,
    matrix: Array,
    lift: Array,
    transfer: Array,
    start: int,
    right: int,
    below: int,
    out: Array,
) -> None:
    """Convert codes to linear light: table lookup of clamp(matrix · (Y, Cb, Cr) + lift).

    rows, columns : (2, length). The chroma samples on either side of a pixel.
    down, across : (length,). Weight of the second chroma sample.
    start : index of the first stored pixel in the upright picture.
    right, below : index steps in the upright picture to the next stored pixel to the right, and below.
    out : (pixels, 3). The upright picture.

    Separate loops over a row let the compiler process several pixels at a time.
    """
    height, width = rows.shape[1], columns.shape[1]
    for y in prange(height):
        blues, reds = np.empty(blue.shape[1], np.float32), np.empty(red.shape[1], np.float32)
        cb, cr, light = np.empty(width, np.float32), np.empty(width, np.float32), np.empty((3, width), np.float32)
        upper, lower, share = rows[0, y], rows[1, y], down[y]
        for x in range(blues.size):
            blues[x] = _between(blue[upper, x], blue[lower, x], share)
            reds[x] = _between(red[upper, x], red[lower, x], share)
        for x in range(width):
            first, second, share = columns[0, x], columns[1, x], across[x]
            cb[x], cr[x] = _between(blues[first], blues[second], share), _between(reds[first], reds[second], share)
        for i in range(3):
            of_luma, of_blue, of_red, more = matrix[i, 0], matrix[i, 1], matrix[i, 2], lift[i]
            for x in range(width):
                code = of_luma * np.float32(luma[y, x]) + of_blue * cb[x] + of_red * cr[x] + more
                light[i, x] = within(code, np.float32(0), np.float32(1))
            for x in range(width):
                light[i, x] = looked_up(transfer, light[i, x])
        for x in range(width):
            at = start + y * below + x * right
            out[at, 0], out[at, 1], out[at, 2] = light[0, x], light[1, x], light[2, x]


@kernel(f"{PLANE}, float32[:, :, :, ::1], {LINE}, {LINE}, {LINE}")
def through_table(codes: Array, table: Array, low: Array, scale: Array, transfer: Array) -> None:
    """Apply a lookup table to codes and convert the result to light, in place.

    codes : (pixels, 3). Within 0..1.
    low, scale : (3,). The position of a code in the table is (code − low) · scale.

    Interpolates in six tetrahedra around each cell's grey diagonal.
    """
    last = np.float32(table.shape[0] - 1)
    for i in prange(codes.shape[0]):
        x, r = _cell((codes[i, 0] - low[0]) * scale[0], last)
        y, g = _cell((codes[i, 1] - low[1]) * scale[1], last)
        z, b = _cell((codes[i, 2] - low[2]) * scale[2], last)
        most, least = max(max(r, g), b), min(min(r, g), b)
        middle = r + g + b - most - least
        red = r == most
        green = not red and g == most
        end_b = b == least
        end_g = not end_b and g == least
        x1, y1, z1 = x + int(red), y + int(green), z + int(not red and not green)
        x2, y2, z2 = x + int(end_b or end_g), y + int(not end_g), z + int(not end_b)
        for c in range(3):
            code = (
                (ONE - most) * table[z, y, x, c]
                + (most - middle) * table[z1, y1, x1, c]
                + (middle - least) * table[z2, y2, x2, c]
                + least * table[z + 1, y + 1, x + 1, c]
            )
            codes[i, c] = looked_up(transfer, within(code, ZERO, ONE))


@inlined
def _cell(position: Any, last: Any) -> Any:
    """Return the cell of a table along one axis, and the position within the cell, 0..1."""
    inside = within(position, ZERO, last)
    cell = min(np.int64(inside), np.int64(last) - 1)
    return cell, inside - np.float32(cell)


@kernel(f"{PLANE}, float32, float32, {LINE}, {PLANE}")
def on_screen(light: Array, ootf: Any, top: Any, gain: Array, matrix: Array) -> None:
    """Convert light of a medium to light on the screen, in place (Rendition). light : (pixels, 3)."""
    for i in prange(light.shape[0]):
        r, g, b = light[i, 0], light[i, 1], light[i, 2]
        share = ONE
        if ootf != ZERO:
            share = max(RED_2020 * r + GREEN_2020 * g + BLUE_2020 * b, SMALL) ** ootf
        brightest = share * max(max(r, g), b)
        share *= looked_up(gain, np.sqrt(np.sqrt(within(brightest / top, ZERO, ONE)))) * top / max(brightest, top)
        r, g, b = share * r, share * g, share * b
        light[i, 0], light[i, 1], light[i, 2] = _within_gamut(
            matrix[0, 0] * r + matrix[0, 1] * g + matrix[0, 2] * b,
            matrix[1, 0] * r + matrix[1, 1] * g + matrix[1, 2] * b,
            matrix[2, 0] * r + matrix[2, 1] * g + matrix[2, 2] * b,
        )


@inlined
def _within_gamut(r: Any, g: Any, b: Any) -> Any:
    grey = within(RED * r + GREEN * g + BLUE * b, ZERO, ONE)
    least, most = min(min(r, g), b), max(max(r, g), b)
    share = ONE
    if least < ZERO:
        share = grey / max(grey - least, SMALL)
    if most > ONE:
        share = min(share, (ONE - grey) / max(most - grey, SMALL))
    return (
        within(grey + share * (r - grey), ZERO, ONE),
        within(grey + share * (g - grey), ZERO, ONE),
        within(grey + share * (b - grey), ZERO, ONE),
    )

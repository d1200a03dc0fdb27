"""Converts linear light to code values: the projector's own primaries, inverse response, then dithering."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from counterlight.passes.drawing import Array
from counterlight.passes.kernel import PICTURE, PLANE, Whole, inlined, kernel, looked_up, prange, within
from counterlight.processing import CELLS
from counterlight.response import RasterResponse

SHADER = "encode.frag"
NO_DITHER, ORDERED, NOISE = range(3)
DITHERS = "none", "ordered", "noise"
SHORT = 0.02  # share of full light; rounding to 8 bits and the tables lose less


class Encode:
    """Converts light to code values.

    response : response of each column's projector.
    scale : light of a white pixel.
    dither : one of DITHERS.
    """

    def __init__(self, response: RasterResponse, scale: float, dither: str) -> None:
        self._codes = np.ascontiguousarray(response.inverse_tables().swapaxes(1, 2))
        self._of_column, self._row_height = response.of_column, response.row_height
        self._mixes = response.matrices is not None
        self._colours = np.zeros((1, 3, 3), np.float32) if response.matrices is None else response.matrices
        none, segments = np.zeros((0, 2, 3, 1), np.float32), response.segment_tables()
        self._segments = none if segments is None else np.ascontiguousarray(segments.swapaxes(2, 3))
        tables = response.processing_tables
        self._processing = np.zeros((0, CELLS, CELLS, CELLS, 3), np.float32) if tables is None else tables
        self._scale, self._dither = np.float32(scale), DITHERS.index(dither)

    def fill(self, light: Array, frame: int, out: NDArray[np.unsignedinteger]) -> None:
        """Encode a picture into `out`, whose type gives 8 or 16 bits per code. frame : number that seeds the noise."""
        projectors = self._codes, self._of_column, self._row_height, self._colours, self._mixes
        processed = self._segments, self._processing
        dithered = self._dither, np.uint32(frame & 0xFFFFFFFF), THRESHOLDS
        encode(light, *projectors, *processed, self._scale, *dithered, np.float32(np.iinfo(out.dtype).max), out)


def encoded(light: NDArray[np.floating], response: RasterResponse, scale: float = 1.0) -> NDArray[np.uint8]:
    """Return the code values of a picture (height, width, 3), without dithering. scale : light of a white pixel."""
    codes = np.empty(light.shape, np.uint8)
    Encode(response, scale, "none").fill(np.ascontiguousarray(light, np.float32), 0, codes)
    return codes


def reached(
    light: NDArray[np.floating], response: RasterResponse, codes: NDArray[np.uint8] | None = None
) -> NDArray[np.float64]:
    """Return a picture's light, 0 to 1, (height, width, 3); where no code values give it, the light that arrives.

    codes : code values of the light, where they are known already.

    Colour processing, a white segment or other primaries make some colours impossible. Losses below SHORT are ignored.
    """
    arriving = response.to_linear(encoded(light, response) if codes is None else codes)
    return np.where(arriving < light - SHORT, arriving, light.astype(np.float64))


def _bayer() -> Array:
    """Return thresholds of ordered dither, repeated every 8 pixels: (8, 8)."""
    y, x = np.mgrid[:8, :8]
    x ^= y
    rank = np.zeros((8, 8), np.int64)
    for bit in range(3):
        rank = (rank << 2) | (((x >> bit) & 1) << 1) | ((y >> bit) & 1)
    return ((rank + 0.5) / 64).astype(np.float32)


THRESHOLDS = _bayer()


@kernel(
    *(
        f"{PICTURE}, {PICTURE}, int32[:, ::1], int64, {PICTURE}, boolean, float32[:, :, :, ::1], "
        f"float32[:, :, :, :, ::1], float32, int64, uint32, {PLANE}, float32, {codes}"
        for codes in ("uint8[:, :, ::1]", "uint16[:, :, ::1]")
    )
)
def encode(
    light: Array,
    codes: Array,
    of_column: Whole,
    row_height: Any,
    colours: Array,
    mixes: Any,
    segments: Array,
    processing: Array,
    scale: Any,
    dither: Any,
    frame: Any,
    thresholds: Array,
    highest: Any,
    out: NDArray[np.unsignedinteger],
) -> None:
    """Convert linear light to code values.

    codes : (projectors, 3, samples). Code values over √light.
    of_column : (rows of projectors, width). Index of the projector that each column belongs to.
    colours : (projectors, 3, 3). Used if `mixes` is true.
    segments : (projectors, 2, 3, samples), or empty.
    processing : (projectors, CELLS, CELLS, CELLS, 3), or empty.
    thresholds : thresholds of ORDERED dither, repeated.
    highest : code of white, 255 or 65535.
    """
    for y in prange(out.shape[0]):
        for x in range(out.shape[1]):
            seed, own = np.uint32(0), of_column[y // row_height, x]
            if dither == NOISE:
                seed = _scrambled(np.uint32(x) + _scrambled(np.uint32(y) + _scrambled(frame)))
            red, green, blue = light[y, x, 0], light[y, x, 1], light[y, x, 2]
            if mixes:
                red, green, blue = (
                    colours[own, 0, 0] * red + colours[own, 0, 1] * green + colours[own, 0, 2] * blue,
                    colours[own, 1, 0] * red + colours[own, 1, 1] * green + colours[own, 1, 2] * blue,
                    colours[own, 2, 0] * red + colours[own, 2, 1] * green + colours[own, 2, 2] * blue,
                )
            roots = _root(red, scale), _root(green, scale), _root(blue, scale)
            if segments.shape[0] > 0:
                roots = _without_segment(roots, segments[own])
            if processing.shape[0] > 0:
                roots = _processed(roots, processing[own])
            threshold = np.float32(0.5)
            if dither == ORDERED:
                threshold = thresholds[y % thresholds.shape[0], x % thresholds.shape[1]]
            for i in range(3):
                if dither == NOISE:
                    hashed = _scrambled(seed + np.uint32(i)) >> np.uint32(9)
                    threshold = np.float32((np.float64(hashed) + 0.5) / 8388608.0)
                value = looked_up(codes[own, i], roots[i]) * highest + threshold
                out[y, x, i] = np.uint16(min(value, highest))


@inlined
def _root(light: Any, scale: Any) -> Any:
    return np.sqrt(within(light / scale, np.float32(0), np.float32(1)))


@inlined
def _without_segment(roots: Any, tables: Any) -> Any:
    """Return √(p − s(m)) of the three primaries, given √p."""
    each = looked_up(tables[0, 0], roots[0]), looked_up(tables[0, 1], roots[1]), looked_up(tables[0, 2], roots[2])
    darkest = np.sqrt(min(each[0], min(each[1], each[2])))
    return (
        np.sqrt(max(roots[0] * roots[0] - looked_up(tables[1, 0], darkest), np.float32(0))),
        np.sqrt(max(roots[1] * roots[1] - looked_up(tables[1, 1], darkest), np.float32(0))),
        np.sqrt(max(roots[2] * roots[2] - looked_up(tables[1, 2], darkest), np.float32(0))),
    )


@inlined
def _processed(roots: Any, table: Any) -> Any:
    """Return √(p / B) of the three primaries, given √p."""
    r, g, b = (
        roots[0] * np.float32(CELLS - 1),
        roots[1] * np.float32(CELLS - 1),
        roots[2] * np.float32(CELLS - 1),
    )
    i, j, k = min(int(r), CELLS - 2), min(int(g), CELLS - 2), min(int(b), CELLS - 2)
    x, y, z = np.float32(r - i), np.float32(g - j), np.float32(b - k)
    red, green, blue = np.float32(0), np.float32(0), np.float32(0)
    for corner in range(8):
        di, dj, dk = corner & 1, (corner >> 1) & 1, corner >> 2
        weight = (x if di else 1 - x) * (y if dj else 1 - y) * (z if dk else 1 - z)
        red += weight * table[i + di, j + dj, k + dk, 0]
        green += weight * table[i + di, j + dj, k + dk, 1]
        blue += weight * table[i + di, j + dj, k + dk, 2]
    one = np.float32(1)
    return min(roots[0] * red, one), min(roots[1] * green, one), min(roots[2] * blue, one)


@inlined
def _scrambled(v: Any) -> Any:
    v = np.uint32(v * np.uint32(747796405) + np.uint32(2891336453))
    v = np.uint32(((v >> ((v >> np.uint32(28)) + np.uint32(4))) ^ v) * np.uint32(277803737))
    return np.uint32((v >> np.uint32(22)) ^ v)

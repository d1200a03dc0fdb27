"""Light to code values, in numpy: the formula of the pass encode, for any number of bits."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import interpn

FloatArray = NDArray[np.floating]


def encode(
    light: FloatArray,
    inverse_response: FloatArray,
    scale: float = 1.0,
    dither: str = "none",
    frame: int = 0,
    of_column: NDArray[np.int32] | None = None,
    row_height: int = 0,
    colours: FloatArray | None = None,
    segments: FloatArray | None = None,
    processing: FloatArray | None = None,
    bits: int = 8,
) -> NDArray[Any]:
    """Convert linear light to code values (encode.frag), uint8 for 8 bits, otherwise uint16.

    inverse_response : (samples, 3), or (projectors, samples, 3) if projectors differ. Code values over √light 0..1.
    scale : light of a white pixel.
    dither : "ordered", "noise" or "none".
    frame : frame number; seeds the noise.
    of_column : (rows of projectors, width). Index of the projector that each column belongs to.
    row_height : height of a row of projectors in pixels; 0 for the whole picture.
    colours : (projectors, 3, 3). From the shared primaries to each projector's own.
    segments : (projectors, 2, samples, 3), from `WhiteSegment.tables`. White light that is subtracted from the
        primaries.
    processing : (projectors, samples, samples, samples, 3). 1 / √B over √light of red, green and blue.
    bits : bits per code value.
    """
    height, width = light.shape[:2]
    tables = inverse_response.reshape(-1, *inverse_response.shape[-2:])
    codes = np.empty(light.shape)
    for row, columns in enumerate(np.zeros((1, width), int) if of_column is None else of_column):
        rows = slice(row * row_height, (row + 1) * row_height or height)
        for number in np.unique(columns):
            own = rows, columns == number
            shown = light[own] if colours is None else light[own] @ colours[number].T
            root = np.sqrt(np.clip(shown / scale, 0, 1))
            root = root if segments is None else _without_segment(root, segments[number])
            if processing is not None:
                axes = (np.linspace(0, 1, processing.shape[1]),) * 3
                root = np.minimum(root * interpn(axes, processing[number].astype(np.float64), root), 1)
            codes[own] = _codes(root, tables[number])
    threshold: float | NDArray[np.float64] = 0.5
    if dither != "none":
        threshold = bayer(height, width) if dither == "ordered" else _noise(height, width, frame)
    highest = 2**bits - 1
    return np.asarray(np.floor(np.minimum(codes * highest + threshold, highest)), np.uint8 if bits == 8 else np.uint16)


def _codes(root: FloatArray, table: FloatArray) -> FloatArray:
    """Look up code values 0..1 for √light, (…, 3)."""
    grid = np.linspace(0, 1, len(table))
    return np.stack([np.interp(root[..., i], grid, table[:, i]) for i in range(3)], axis=-1)


def _without_segment(root: FloatArray, tables: FloatArray) -> FloatArray:
    """Return √(p − s(m)) for √p, (…, 3). m is the level of the darkest primary after the subtraction."""
    grid = np.linspace(0, 1, tables.shape[1])
    each = [np.interp(root[..., i], grid, tables[0, :, i]) for i in range(3)]
    darkest = np.sqrt(np.min(each, axis=0))
    segment = np.stack([np.interp(darkest, grid, tables[1, :, i]) for i in range(3)], axis=-1)
    return np.asarray(np.sqrt(np.maximum(root**2 - segment, 0)))


def bayer(height: int, width: int) -> NDArray[np.float64]:
    """Return thresholds of ordered dither, repeated every 8 pixels: (height, width, 1)."""
    y, x = np.mgrid[:height, :width]
    x ^= y
    rank = np.zeros((height, width), np.int64)
    for bit in range(3):
        rank = (rank << 2) | (((x >> bit) & 1) << 1) | ((y >> bit) & 1)
    return ((rank + 0.5) / 64)[..., None]


def _noise(height: int, width: int, frame: int) -> NDArray[np.float64]:
    """Return uniform thresholds from the PCG hash of pixel, channel and frame (Jarzynski and Olano 2020)."""
    y, x = np.mgrid[:height, :width].astype(np.uint32)
    seed = _scramble(x + _scramble(y + _scramble(np.full((1, 1), frame & 0xFFFFFFFF, np.uint32))))
    noise = np.stack([_scramble(seed + np.uint32(i)) for i in range(3)], axis=-1)
    return ((noise >> np.uint32(9)).astype(np.float64) + 0.5) / 8388608.0


def _scramble(v: NDArray[np.uint32]) -> NDArray[np.uint32]:
    v = v * np.uint32(747796405) + np.uint32(2891336453)
    v = ((v >> ((v >> np.uint32(28)) + np.uint32(4))) ^ v) * np.uint32(277803737)
    return (v >> np.uint32(22)) ^ v

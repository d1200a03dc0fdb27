"""Decode Gray-code captures: find the projector pixel that each camera pixel sees.

A bit is read by comparing a pattern with its inverse in the same pixel, so that no threshold can fail on texture or
shadow (Scharstein and Szeliski 2003, High-accuracy stereo depth maps using structured light).

Contrast alone decides which pixels are trusted. A comparison with the median of the neighbours was measured on the real
captures and left out. At a contrast of 5 code values, 0.02 % (flat board) and 0.7 % (glossy shell) of the pixels lie
more than 4 projector pixels off their epipolar line. Pixels that deviate from their neighbours are almost never among
them. At a contrast of 2 the shares are 0.2 % and 4 %, hence the default of 5.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from counterlight.command import track
from counterlight.errors import InputError
from counterlight.files.picture_files import read_picture
from counterlight.response import Response
from counterlight.tools.acquisition.captures import Captures, Pair

WIDE_STRIPES = 8  # cells; defocus and the camera blur narrower stripes
EIGHT_BIT = 255.0


@dataclass(frozen=True)
class Decoded:
    """The code and the light of each camera pixel.

    x, y : (height, width) int32. Column and row of the code, possibly beyond the projector.
    contrast : (height, width) float32. Least difference of a pattern and its inverse, 0 to 1 of the code values.
    white, black : (height, width, 3) float32. Linear light, floodlit and dark, 0 to 1.
    saturated : (height, width) bool. White is at the top of the camera's range in some channel.
    colour : whether the captures have colour.
    """

    x: NDArray[np.int32]
    y: NDArray[np.int32]
    contrast: NDArray[np.float32]
    white: NDArray[np.float32]
    black: NDArray[np.float32]
    saturated: NDArray[np.bool_]
    colour: bool

    @property
    def shape(self) -> tuple[int, int]:
        return self.contrast.shape[0], self.contrast.shape[1]

    def valid(self, cells: tuple[int, int], min_contrast: float) -> NDArray[np.bool_]:
        """Returns the pixels in which every bit is sure and whose cell is inside the projector.

        cells : (rows, columns) of the code.
        min_contrast : least contrast in 8-bit code values.
        """
        inside = (self.y < cells[0]) & (self.x < cells[1])
        # Slack of a thousandth of a code value: 5/255 · 255 in float32 may fall below 5.
        return np.asarray(inside & (self.contrast * EIGHT_BIT >= min_contrast - 1e-3))


def decode(captures: Captures, response: Response) -> Decoded:
    """Decode all captures, with one pair in memory at a time.

    response : response of the camera. Only white and black need it; any rising curve gives the same bits.

    Raises InputError for unreadable captures and for captures that differ in size or kind.
    """
    reader = _Reader(captures.columns[0].pattern)
    flood = None if captures.white and captures.black else _FloodFromPairs((*reader.shape, 3 if reader.colour else 1))
    codes, contrasts = [], []
    for axis, pairs in (("columns", captures.columns), ("rows", captures.rows)):
        code, contrast = _decode_axis(pairs, axis, reader, flood)
        codes.append(code)
        contrasts.append(contrast)
    white, black = (_light(path, reader, flood, i) for i, path in enumerate((captures.white, captures.black)))
    return Decoded(
        codes[0],
        codes[1],
        np.minimum(*contrasts),
        _linear(white, response),
        _linear(black, response),
        np.asarray(np.any(white >= 1, axis=-1)),
        reader.colour,
    )


class _Reader:
    """Reads captures, all of the same size and kind."""

    def __init__(self, first: Path) -> None:
        picture = read_picture(first)
        self._first, self._shape, self._dtype = first, picture.shape, picture.dtype
        self.full_scale = float(np.iinfo(picture.dtype).max)

    @property
    def shape(self) -> tuple[int, int]:
        return self._shape[0], self._shape[1]

    @property
    def colour(self) -> bool:
        return len(self._shape) == 3

    def stored(self, path: Path) -> NDArray[Any]:
        picture = read_picture(path)
        if picture.shape != self._shape or picture.dtype != self._dtype:
            raise InputError(
                f"{path}: {_kind(picture.shape, picture.dtype)}, expected {_kind(self._shape, self._dtype)} as in "
                f"{self._first.name}; all captures come from one camera with one setting"
            )
        return picture

    def light(self, path: Path) -> NDArray[np.float32]:
        """Returns (height, width, 3) or, for a grey camera, (height, width, 1), 0 to 1."""
        return scaled(self.stored(path), self.full_scale)


def scaled(picture: NDArray[Any], full_scale: float) -> NDArray[np.float32]:
    channels = picture if picture.ndim == 3 else picture[..., None]
    return np.asarray(channels, np.float32) / np.float32(full_scale)


def luma(picture: NDArray[Any]) -> NDArray[Any]:
    """Returns the luma (BT.601) of a stored RGB picture, or the picture itself if it is grey."""
    return picture if picture.ndim == 2 else np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY))


class _FloodFromPairs:
    """Estimates missing white and black captures from the pairs with wide stripes.

    In each pair, a pixel is lit once and dark once. The means over the wide pairs are white minus, and black plus,
    half of the light that reaches the pixel indirectly (Nayar et al. 2006). The maximum over all pairs would be too
    bright because of noise, and narrow stripes too dark because of defocus.
    """

    def __init__(self, shape: tuple[int, ...]) -> None:
        self._lit, self._dark = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
        self._pairs = 0

    def add(self, pattern: NDArray[np.float32], inverse: NDArray[np.float32], bit: NDArray[np.bool_]) -> None:
        """Add a pair; `bit` (height, width) is True where the pattern, and not its inverse, is lit."""
        self._lit += np.where(bit[..., None], pattern, inverse)
        self._dark += np.where(bit[..., None], inverse, pattern)
        self._pairs += 1

    def white_and_black(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        return self._lit / np.float32(self._pairs), self._dark / np.float32(self._pairs)


def _decode_axis(
    pairs: Sequence[Pair], axis: str, reader: _Reader, flood: "_FloodFromPairs | None"
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Returns code and least contrast of one axis; binary bit = Gray bit xor the next higher binary bit.

    flood : receives the pairs with wide stripes, at least the widest of each axis.
    """
    code = np.zeros(reader.shape, np.int32)
    contrast = np.full(reader.shape, np.inf, np.float32)
    binary = np.zeros(reader.shape, np.bool_)
    for pair in track(pairs, f"decoding {axis}", len(pairs)):
        pattern, inverse = reader.stored(pair.pattern), reader.stored(pair.inverse)
        difference = luma(pattern).astype(np.int32) - luma(inverse)
        bit = difference > 0
        binary ^= bit
        code = 2 * code + binary
        np.minimum(contrast, np.abs(difference) / np.float32(reader.full_scale), out=contrast)
        if flood and (2 << pair.bit >= WIDE_STRIPES or pair is pairs[0]):
            flood.add(scaled(pattern, reader.full_scale), scaled(inverse, reader.full_scale), bit)
    return code, contrast


def _light(path: Path | None, reader: _Reader, flood: _FloodFromPairs | None, which: int) -> NDArray[np.float32]:
    """Returns white (`which` 0) or black (1), captured or estimated from the pairs."""
    if path is not None:
        return reader.light(path)
    if flood is None:
        raise AssertionError("without white and black, the pairs are summed")
    return flood.white_and_black()[which]


def _linear(light: NDArray[np.float32], response: Response) -> NDArray[np.float32]:
    three = np.broadcast_to(light, (*light.shape[:2], 3))
    return response.to_linear(three.astype(np.float64)).astype(np.float32)


def _kind(shape: tuple[int, ...], dtype: np.dtype[Any]) -> str:
    return f"{shape[1]}x{shape[0]} {'colour' if len(shape) == 3 else 'grey'} {8 * dtype.itemsize}-bit"

"""What surfaces are made of: albedo over a surface's (u, v), per colour channel, 0..1."""

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from player.errors import InputError
from player.response import Response

FloatArray = NDArray[np.float64]
MORTAR = 0.08  # of a brick's height
MAX_TEXTURE_PIXELS = 1 << 26


class Material(Protocol):
    """Something with a colour at every point."""

    def albedo(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Diffuse reflectance (…, 3) at u, v (…) in 0..1."""


@dataclass(frozen=True)
class PlainColour:
    """The same albedo (3,) everywhere."""

    colour: FloatArray

    def albedo(self, u: FloatArray, v: FloatArray) -> FloatArray:
        return np.broadcast_to(self.colour, (*np.shape(u), 3)).astype(np.float64)


@dataclass(frozen=True)
class Texture:
    """An albedo picture (rows, columns, 3), its left column at u = 0 and its bottom row at v = 0; nearest texel."""

    picture: FloatArray

    def albedo(self, u: FloatArray, v: FloatArray) -> FloatArray:
        height, width = self.picture.shape[:2]
        column = np.clip((u * width).astype(np.int64), 0, width - 1)
        row = np.clip(((1 - v) * height).astype(np.int64), 0, height - 1)
        return np.asarray(self.picture[row, column])


@dataclass(frozen=True)
class Pattern:
    """Two colours: bricks and mortar, stripes along v, or a checker.

    repeat : how many along u and v.  variation : how much single bricks, stripes or fields differ, 0..1.
    """

    kind: str
    colours: FloatArray
    repeat: tuple[float, float]
    variation: float

    def albedo(self, u: FloatArray, v: FloatArray) -> FloatArray:
        x, y = u * self.repeat[0], v * self.repeat[1]
        row = np.zeros_like(y) if self.kind == "stripes" else np.floor(y)
        if self.kind == "bricks":
            x = x + 0.5 * (row % 2)
        column = np.floor(x)
        if self.kind == "bricks":
            second = (y - row < MORTAR) | (x - column < MORTAR * self.repeat[0] / self.repeat[1])
        else:
            second = (column + row) % 2 == 1
        shade = 1 - self.variation * _hash(column, row)
        return np.asarray(np.where(second[..., None], self.colours[1], self.colours[0] * shade[..., None]))


def read_texture(path: Path, where: str) -> FloatArray:
    """An sRGB picture file as albedo (rows, columns, 3); InputError starting with `where`."""
    picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if picture is None:
        raise InputError(f"{where}: {path} is no readable picture; check the path, or save it as PNG")
    if picture.shape[0] * picture.shape[1] > MAX_TEXTURE_PIXELS:
        raise InputError(f"{where}: {path} has more than {MAX_TEXTURE_PIXELS} pixels; make it smaller")
    return Response("srgb").to_linear(picture[..., ::-1].astype(np.float64) / 255)


def _hash(i: FloatArray, j: FloatArray) -> FloatArray:
    """A number in 0..1 for each pair of whole numbers, always the same."""
    mixed = (i.astype(np.int64) * 73856093 ^ j.astype(np.int64) * 19349663) & 0x7FFFFFFF
    return (mixed * 2654435761 % 1000003) / 1000003.0

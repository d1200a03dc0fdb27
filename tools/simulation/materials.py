"""Materials of surfaces: albedo per colour channel, 0..1, over the surface's (u, v), and optical properties."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from counterlight import memory
from counterlight.arrays import FloatArray
from counterlight.errors import InputError
from counterlight.files.picture_files import read_picture
from counterlight.files.tables import Table
from counterlight.response import Response

PATTERNS = ("bricks", "stripes", "checker")
MORTAR = 0.08  # width of the mortar, as a share of a brick's height
MAX_TEXTURE_PIXELS, TEXEL_BYTES = 1 << 26, 4 * 3 * 8  # bytes per texel while reading, in float64


class Paint(Protocol):
    """A material with a colour at every point."""

    def albedo(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Returns diffuse reflectance (…, 3) at u, v (…) in 0..1."""


@dataclass(frozen=True)
class Gloss:
    """A coat that reflects.

    reflectance : at normal incidence, 0..1.
    roughness : 0 (mirror) to 1 (dull).
    """

    reflectance: float
    roughness: float


@dataclass(frozen=True)
class Dielectric:
    """A clear solid.

    index : refractive index at 587.6 nm.
    abbe : Abbe number; infinite for no dispersion.
    absorption : (3,), per metre.
    """

    index: float
    abbe: float
    absorption: FloatArray


@dataclass(frozen=True)
class Translucency:
    """Scattering below the surface: light leaves away from where it enters. The mean free path (3,) is in metres."""

    mean_free_path: FloatArray


@dataclass(frozen=True)
class Material:
    """A matt paint and optional optical properties; None for absent properties.

    overlap : (3, 3), channel by primary. Reflectance in the part of each primary that the channel sees, as a share of
        the paint's albedo; None for all 1.
    """

    paint: Paint
    gloss: Gloss | None = None
    dielectric: Dielectric | None = None
    translucency: Translucency | None = None
    overlap: FloatArray | None = None

    def albedo(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Returns diffuse reflectance (…, 3) at u, v (…) in 0..1."""
        return self.paint.albedo(u, v)

    def enlarged(self, scale: float) -> "Material":
        """Returns the material for pixels `scale` times as large: scattering and dispersion stay equal in pixels."""
        body, solid = self.translucency, self.dielectric
        return replace(
            self,
            translucency=body and Translucency(scale * body.mean_free_path),
            dielectric=solid and replace(solid, abbe=solid.abbe / scale),
        )


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

    repeat : numbers of elements along u and v.
    variation : how much single bricks, stripes or fields differ, 0..1.
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


def read_material(table: Table, folder: Path) -> Material:
    """Read a surface's material from its table; a dielectric needs no paint."""
    dielectric = _dielectric(table.table("dielectric")) if "dielectric" in table else None
    gloss = _gloss(table.table("gloss")) if "gloss" in table else None
    translucency = _translucency(table.table("translucency")) if "translucency" in table else None
    if gloss is not None and translucency is not None:
        raise InputError(f"{table.where}: takes gloss or translucency, not both; leave one out")
    if dielectric is not None and (gloss is not None or translucency is not None):
        raise InputError(f"{table.where}: a dielectric takes neither gloss nor translucency; leave them out")
    kinds = [key for key in ("albedo", "texture", "pattern") if key in table]
    if dielectric is not None:
        if kinds:
            raise InputError(f"{table.where}, {kinds[0]}: a dielectric is clear; colour it with its absorption")
        return Material(PlainColour(np.zeros(3)), dielectric=dielectric)
    if len(kinds) != 1:
        raise InputError(
            f"{table.where}: found {' and '.join(kinds) or 'none'}, expected one of albedo, texture, pattern"
        )
    overlap = table.rows("overlap", 3, 3, 0.0, 2.0) if "overlap" in table else None
    return Material(_paint(table, folder, kinds[0]), gloss, None, translucency, overlap)


def _paint(table: Table, folder: Path, kind: str) -> Paint:
    if kind == "albedo":
        return PlainColour(table.colour("albedo"))
    if kind == "texture":
        return Texture(read_texture(table.path("texture", folder), f"{table.where}, texture"))
    pattern = table.table("pattern")
    chosen = pattern.choice("kind", PATTERNS)
    colours = pattern.rows("colours", 2, 3, 0.0, 1.0)
    repeat = pattern.numbers("repeat", 2, (8.0, 8.0), 1e-3, 1e4)
    result = Pattern(chosen, colours, (float(repeat[0]), float(repeat[1])), pattern.number("variation", 0.0, 0.0, 1.0))
    pattern.refuse_unknown()
    return result


def _gloss(table: Table) -> Gloss:
    gloss = Gloss(table.number("reflectance", 0.04, 0.0, 1.0), table.number("roughness", None, 0.0, 1.0))
    table.refuse_unknown()
    return gloss


def _dielectric(table: Table) -> Dielectric:
    result = Dielectric(
        table.number("index", None, 1.0, 4.0),
        table.number("abbe", np.inf, 5.0, np.inf),
        table.vector("absorption", (0.0, 0.0, 0.0), low=0.0),
    )
    table.refuse_unknown()
    return result


def _translucency(table: Table) -> Translucency:
    result = Translucency(table.vector("mean_free_path", None, low=1e-6))
    table.refuse_unknown()
    return result


def read_texture(path: Path, where: str) -> FloatArray:
    """Read an sRGB picture file (PNG or JPEG) as albedo (rows, columns, 3).

    Raises InputError starting with `where`.
    """
    try:
        picture = read_picture(path, MAX_TEXTURE_PIXELS, upright=True)
        memory.check(TEXEL_BYTES * picture.shape[0] * picture.shape[1], f"{path}: its light", "make it smaller")
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    srgb = picture.astype(np.float64) / np.iinfo(picture.dtype).max
    return Response("srgb").to_linear(srgb if srgb.ndim == 3 else np.repeat(srgb[..., None], 3, axis=2))


def _hash(i: FloatArray, j: FloatArray) -> FloatArray:
    """Returns a reproducible number in 0..1 for each pair of integers."""
    mixed = (i.astype(np.int64) * 73856093 ^ j.astype(np.int64) * 19349663) & 0x7FFFFFFF
    return (mixed * 2654435761 % 1000003) / 1000003.0

"""The mixing of the projector's primaries by the camera's colours (thesis 4.1.1), and the conversions through it.

Channel k of a camera pixel sees c_k = Σ_l F_kl t_l + e_k for shares t of the three primaries. Pictures are stated in
*screen primaries*: s = Q c with Q = M₀⁻¹. M₀ is the mixing of a neutral surface; its rows sum to 1, so that white stays
white. In screen primaries, channels nearly decouple; the remaining mixing of a camera pixel is P = Q F. B holds the
columns of P, scaled to unit length. With w the columns' lengths, y = w ∘ t is the light of the maps' transport T̃, and

    seen = B y + Q e,        target: b = A (picture − Q e),  A = B⁻¹.

Each column of B has length 1. Therefore the squared error of y equals the squared error of the seen picture, except for
the products of two primaries. There are three tiers. In `independent`, M₀ = B = I, so that each channel stands by
itself. In `global`, the room has one M₀, and B = I. In `pixel`, each camera pixel also has its B.
"""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray, brief
from counterlight.calibration import RADIANCE
from counterlight.errors import InputError
from counterlight.files import exr
from counterlight.files.reading import DescribedFiles
from counterlight.files.tables import Table

Light: TypeAlias = NDArray[np.floating]
TIERS = ("independent", "global", "pixel")
FILES = "mixing_red.exr", "mixing_green.exr", "mixing_blue.exr"
LARGEST_INVERSE = 1e3  # largest entry of Q or A; beyond it, a thousandth of the light would decide a picture's colour
UNLIMITED = RADIANCE[1]
SWEEPS = 3  # sweeps; 60 sweeps come only 0.005 % nearer for a light that exceeds the range by a fifth
ROUNDING = 1e-3  # allowed error of a sum that was written as text or as float32


@dataclass(frozen=True)
class Mixing:
    """The conversions between camera radiance, a picture in screen primaries, and the light of the maps' transport.

    neutral : M₀, (3, 3), camera channel by primary; None if channels are independent.
    pixel : B, (camera height, camera width, 3, 3) float32, screen primary by primary; None for no mixing besides M₀.
    """

    neutral: FloatArray | None = None
    pixel: NDArray[np.float32] | None = None

    __repr__ = brief

    @property
    def tier(self) -> str:
        """One of TIERS."""
        return TIERS[(self.neutral is not None) + (self.pixel is not None)]

    @cached_property
    def to_screen(self) -> FloatArray:
        """Q = M₀⁻¹."""
        return np.eye(3) if self.neutral is None else np.asarray(np.linalg.inv(self.neutral))

    @cached_property
    def inverse(self) -> NDArray[np.float32] | None:
        """A = B⁻¹ of every camera pixel."""
        return None if self.pixel is None else np.linalg.inv(self.pixel.astype(np.float64)).astype(np.float32)

    @property
    def of_camera(self) -> FloatArray | None:
        """From the transport's light to camera radiance: M₀ B of every camera pixel, or M₀; None without mixing."""
        if self.neutral is None:
            return None
        return self.neutral if self.pixel is None else np.asarray(self.neutral @ self.pixel)

    def on_screen(self, radiance: Light) -> Light:
        """Return Q c: camera radiance in screen primaries, (…, 3)."""
        return radiance if self.neutral is None else radiance @ self.to_screen.T.astype(radiance.dtype)

    def as_radiance(self, light: Light) -> Light:
        """Return M₀ s: camera radiance of a picture in screen primaries, (…, 3)."""
        return light if self.neutral is None else light @ self.neutral.T.astype(light.dtype)

    def unmixed(self, light: Light) -> Light:
        """Return A s: light above ambient, (camera height, camera width, 3), as light of the maps' transport."""
        return light if self.inverse is None else mixed(self.inverse, light)

    @cached_property
    def squares(self) -> FloatArray:
        """Q Qᵀ for `spread`: (3, 3)."""
        return self.to_screen @ self.to_screen.T

    def within(self, light: Light, full: Light) -> Light:
        """Return the light within 0 to `full` (T̃·1) that the camera sees nearest to `light`.

        light, full : (camera pixels, 3), or pictures.
        """
        result = np.clip(light, 0, full)
        if self.inverse is not None:
            beyond = np.any(light != result, axis=-1)
            inverse = self.inverse.reshape(*light.shape, 3)[beyond]
            result[beyond] = nearest(light[beyond], full[beyond], spread(inverse, self.squares))
        return result

    def seen(self, light: Light) -> Light:
        """Return B y: light of the maps' transport, (camera height, camera width, 3), in screen primaries."""
        return light if self.pixel is None else mixed(self.pixel, light)

    def unmixed_transpose(self, light: Light) -> Light:
        """Apply Aᵀ, the transpose of the matrix in `unmixed`."""
        return light if self.inverse is None else mixed(np.swapaxes(self.inverse, -1, -2), light)

    def seen_transpose(self, light: Light) -> Light:
        """Apply Bᵀ, the transpose of `seen`."""
        return light if self.pixel is None else mixed(np.swapaxes(self.pixel, -1, -2), light)

    def brightest(self, white: float, ambient: Light) -> Light:
        """Return the largest |b| of each camera pixel and channel for a picture of at most white.

        ambient : Q e, (camera height, camera width, 3).
        """
        light = np.maximum(white, np.abs(ambient)).astype(np.float64)
        return light if self.inverse is None else mixed(np.abs(self.inverse), light)

    def reach(self, full: Light, ambient: Light) -> Light:
        """Return the brightest grey that each primary allows a camera pixel, radiance (camera height, camera width, 3).

        A grey g needs g A 1 − A Q e of the full light T̃·1.

        full : T̃·1.
        ambient : Q e.
        """
        if self.inverse is None:
            return full + ambient
        return grey_reach(self.inverse, full, ambient)

    def shared(self, share: NDArray[np.float32]) -> "Mixing":
        """Return the mixing for maps whose transport gives only a share of the visible light.

        The result holds B / share, so that A gives a target for only that share.

        share : (camera height, camera width).
        """
        pixel = np.eye(3, dtype=np.float32) if self.pixel is None else self.pixel
        return Mixing(self.neutral, np.asarray(pixel / share[..., None, None], np.float32))

    def to_toml(self) -> dict[str, Any]:
        """Return the manifest's table [colour]; empty for independent channels."""
        if self.neutral is None:
            return {}
        return {"colour": {"tier": self.tier, "neutral": self.neutral.tolist()}}


def mixed(matrices: Light, light: Light) -> Light:
    """Return M v in every pixel (mix.frag).

    matrices : (height, width, 3, 3).
    light : (height, width, 3).
    """
    return np.asarray(np.einsum("...kl,...l->...k", matrices, light))


def spread(inverse: Light, squares: Light) -> FloatArray:
    """Return N = A Q Qᵀ Aᵀ, the inverse of (M₀ B)ᵀ M₀ B: how other primaries compensate for a limited primary."""
    return np.asarray(inverse @ squares @ np.swapaxes(inverse, -1, -2))


def nearest(light: Light, full: Light, spread: FloatArray) -> FloatArray:
    """Return y within 0 to full with the least (y − light)ᵀ N⁻¹ (y − light) (desired.frag).

    If one primary reaches its limit, the others compensate. Hildreth 1957, A quadratic programming procedure: limit
    after limit, y moves along its column of N, SWEEPS times.

    light, full : (…, 3).
    spread : N, (…, 3, 3).
    """
    y = np.array(light, np.float64)
    moved = np.zeros_like(y)
    for primary in [0, 1, 2] * SWEEPS:
        own = spread[..., primary, primary]
        alone = y[..., primary] - own * moved[..., primary]
        more = (np.clip(alone, 0, full[..., primary]) - alone) / own - moved[..., primary]
        y += spread[..., primary] * more[..., None]
        moved[..., primary] += more
    return np.clip(y, 0, full)


def grey_reach(inverse: Light, full: Light, ambient: Light) -> Light:
    """Return the greys of Mixing.reach; a primary that grey does not need sets no limit (reach.frag)."""
    share = np.asarray(inverse.sum(axis=-1, dtype=np.float64))
    limit = full + mixed(inverse, ambient)
    return np.where(share > 0, np.minimum(limit, UNLIMITED * share) / np.where(share > 0, share, 1), UNLIMITED)


def write(mixing: Mixing, stage: Path) -> None:
    """Write the rows of B as three pictures, if B exists."""
    if mixing.pixel is not None:
        for row, name in enumerate(FILES):
            exr.write_plain(stage / name, exr.rgb(mixing.pixel[..., row, :]))


def read(manifest: Table, files: DescribedFiles, camera: tuple[int, int]) -> Mixing:
    """Read the files of `to_toml` and `write`; raises InputError for a mixing that cannot be inverted."""
    if "colour" not in manifest:
        return Mixing()
    table = manifest.table("colour")
    tier, neutral = table.choice("tier", TIERS[1:]), table.rows("neutral", 3, 3, -LARGEST_INVERSE, LARGEST_INVERSE)
    if np.abs(neutral.sum(axis=1) - 1).max() > ROUNDING or not invertible(neutral).all():
        raise table.wrong("neutral", "the mixing of a neutral surface: rows of sum 1 that can be distinguished")
    if tier != "pixel":
        return Mixing(neutral)
    pixel = np.stack([exr.read_described(files, name, camera, "the camera") for name in FILES], axis=2)
    check_pixels(pixel, f"{files.folder / FILES[0]} and its siblings", files.fix)
    return Mixing(neutral, pixel)


def check_pixels(pixel: NDArray[np.floating], where: str, fix: str) -> None:
    """Raise InputError for a B that is not finite, lacks unit columns, or cannot be inverted."""
    with np.errstate(over="ignore", invalid="ignore"):
        lengths = np.linalg.norm(pixel.astype(np.float64), axis=2)
    if not (np.abs(lengths - 1) <= ROUNDING).all() or not invertible(pixel).all():
        raise InputError(f"{where}: holds a mixing that is no number, not of unit columns, or cannot be undone; {fix}")


def invertible(matrices: Light, largest: float = LARGEST_INVERSE) -> NDArray[np.bool_]:
    """Return which 3×3 matrices, (…, 3, 3), have an inverse with no entry above `largest`; False for NaN.

    Cofactors are used, so that a singular matrix does not stop the others.
    """
    rows = np.moveaxis(np.asarray(matrices, np.float64), -2, 0)
    finite = np.asarray(np.isfinite(matrices).all(axis=(-2, -1)))
    a, b, c = (np.where(finite[..., None], row, 0.0) for row in rows)
    cofactors = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)])
    determinant = np.abs(np.sum(a * cofactors[0], axis=-1))
    return np.asarray(finite & (np.abs(cofactors).max(axis=(0, -1)) <= largest * determinant) & (determinant > 0))

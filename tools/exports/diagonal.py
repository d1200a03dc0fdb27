"""A room reduced to one place per projector pixel of T: drive = picture(place) · α (1 − β) + β.

All values are linear light. α makes white even and blends projectors that overlap, because it divides by the light of
all projectors together. β lifts dark places to the black of the brightest ones. With D = T·1 of the pixel, white w, its
own black e and the common black b: α (1 − β) = (w − b) / D and β = (b − e) / D, so that the camera sees b + (w − b) m.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse

from counterlight.arrays import BoolArray, FloatArray
from counterlight.errors import InputError
from counterlight.pipeline.fitting import on_cameras
from counterlight.tools.api import Room, solve
from counterlight.tools.inverse.pictures import typical_pictures
from counterlight.tools.transport.transport import Csr, in_one, luminance

BLACK_PERCENTILE = 99  # over the camera pixels that count; highlights must not lift the black of the whole room
SPREADS = 2.0  # largest distance from a footprint's brightest camera pixel, in spreads of a typical footprint


@dataclass(frozen=True)
class Diagonal:
    """Place, factor and offset of each projector pixel.

    places : (height, width, 2). x and y in the target picture, 0 to 1 from its upper left corner.
    seen : (height, width). False where no camera pixel sees a projector pixel; the place is then that of a neighbour.
    alpha, beta : (height, width, 3), 0 to 1, linear light. 0 where a projector pixel is not seen.
    target : (height, width) of the target picture.
    black : (3,). Radiance that black is lifted to.
    """

    places: FloatArray
    seen: BoolArray
    alpha: FloatArray
    beta: FloatArray
    target: tuple[int, int]
    black: FloatArray

    def drive(self, picture: FloatArray) -> FloatArray:
        """Returns the drive for a target picture (height, width, 3), linear, as other programs compute it."""
        x, y = np.moveaxis(self.places * self.target[::-1] - 0.5, -1, 0).astype(np.float32)
        warped = cv2.remap(picture.astype(np.float32), x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.clip(warped * self.alpha * (1 - self.beta) + self.beta, 0, 1)


def diagonal(room: Room) -> Diagonal:
    """Reduce a room to its diagonal. Raises InputError if no camera pixel sees the projector."""
    tier, camera, projector = room.tier, room.camera, room.projector
    footprints = _footprints(room)
    sums = np.asarray(footprints.sum(axis=1)).ravel()
    seen = sums > 0
    if not seen.any():
        raise InputError(f"{room.calibration.name}: no camera pixel sees the projector; check the room's matrices")
    mean = sparse.diags_array(1 / np.where(seen, sums, 1)) @ footprints

    def per_projector_pixel(values: NDArray[np.floating]) -> FloatArray:
        return np.asarray(mean @ values.reshape(camera[0] * camera[1], -1)).reshape(*projector, -1)

    size = room.calibration.placed_on
    dark, bright = per_projector_pixel(tier.ambient), per_projector_pixel(tier.reach)
    black: FloatArray = np.percentile(tier.ambient[room.mask].astype(np.float64), BLACK_PERCENTILE, axis=0)
    full = np.maximum(bright - dark, np.finfo(np.float32).tiny)
    lit = seen.reshape(projector)
    beta = np.clip((black - dark) / full, 0, 1)
    alpha = np.clip((room.white - black) / full / np.maximum(1 - beta, 1e-6), 0, 1)
    places = per_projector_pixel(_positions(room)) / size[::-1]
    nearest = ndimage.distance_transform_edt(~lit, return_distances=False, return_indices=True)
    return Diagonal(places[tuple(nearest)], lit, alpha * lit[..., None], beta * lit[..., None], size, black)


def lost(room: Room, kept: Diagonal) -> tuple[float, float]:
    """Returns the PSNR in dB, relative to white, of a typical picture: by the diagonal, and by the best drive.

    Both are judged by the lifted target b + (w - b) m, which the diagonal aims at.
    """
    source = np.repeat(typical_pictures(kept.target)[0][..., None], 3, axis=2)
    picture = on_cameras(source, room.calibration)
    target = kept.black + (room.white - kept.black) * picture
    best = solve(room, target / room.white)
    errors = ((seen - target)[room.lit] / room.white for seen in (room.seen(kept.drive(source)), best.seen))
    warped, solved = map(_decibels, errors)
    return warped, solved


def _footprints(room: Room) -> Csr:
    """Returns the share of each camera pixel's light that a projector pixel gives, (projector pixels, camera pixels).

    Shares do not depend on the paint of the scene. Bounces and highlights, which lie far from a projector pixel's
    brightest entry in the target picture, are left out.
    """
    rows = room.parts.near if room.parts.blurred is None else in_one(room.parts.without_far)
    weights, camera_pixel = luminance(rows.weights), rows.rows
    totals = np.bincount(camera_pixel, weights, rows.shape[0])[camera_pixel]
    shares = np.divide(weights, totals, out=np.zeros_like(weights), where=totals > 0)
    x, y = _positions(room).reshape(-1, 2)[camera_pixel].T
    order = np.argsort(shares, kind="stable")
    brightest = np.zeros(rows.columns, np.int64)
    brightest[rows.indices[order]] = order  # of equal indices, numpy keeps the last assignment
    own = brightest[rows.indices]
    distance = np.hypot(x - x[own], y - y[own])
    sums = np.bincount(rows.indices, shares, rows.columns)
    squares = np.bincount(rows.indices, shares * distance**2, rows.columns)
    lit = sums > 0
    spread = float(np.median(np.sqrt(squares[lit] / sums[lit]))) if lit.any() else 0.0
    near = distance <= 1 + SPREADS * spread
    return Csr((shares * near, (rows.indices, camera_pixel)), shape=rows.shape[::-1])


def _positions(room: Room) -> FloatArray:
    """Returns where camera pixels look in the target picture, x and y from its upper left corner, in pixels."""
    screen = room.calibration.screen
    if screen is not None:
        return np.nan_to_num(screen.positions.astype(np.float64))
    y, x = np.mgrid[: room.camera[0], : room.camera[1]]
    return np.stack([x, y], axis=-1) + 0.5


def _decibels(error: FloatArray) -> float:
    return float(-20 * np.log10(max(np.sqrt(np.mean(error**2)), 1e-9)))

"""Footprint of each projector pixel, sharp or out of focus, from the places where light meets a surface.

A surface sample at raster position (u, v) is lit by pixel j along an axis. The share is the part of j's unit box under
a Gaussian around u (the focused lens), cut at three σ and normalised to 1. A lens out of focus is a disc of points,
each with its own picture, so that shadows get penumbras. A moved projector is a shift of (u, v), without resampling.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.special import ndtr

from tests.rig.rays import FloatArray, Pinhole, Rectangle

LENS = 0.3  # σ of a focused lens, projector pixels
CUT = 3.0
CHUNK = 1 << 18  # number of hits per chunk
VIGNETTING = 0.15  # loss of flux, at half the raster's width from the axis


@dataclass(frozen=True)
class Hits:
    """Light that arrives at samples of surfaces.

    sample : (n,). Index of the sample; several hits of a sample add up.
    uv : (n, 2). Raster position, pixels.
    irradiance : (n,). From a raster without borders at full drive.
    """

    sample: NDArray[np.int64]
    uv: FloatArray
    irradiance: FloatArray


def joined(hits: Sequence[Hits]) -> Hits:
    return Hits(
        np.concatenate([each.sample for each in hits]),
        np.concatenate([each.uv for each in hits]),
        np.concatenate([each.irradiance for each in hits]),
    )


def flux(projector: Pinhole, uv: FloatArray) -> FloatArray:
    """Returns the flux of a pixel at `uv` at full drive, relative to the middle of the raster."""
    height, width = projector.size
    squared = np.sum((uv - (width / 2, height / 2)) ** 2, axis=-1) / (width / 2) ** 2
    return np.asarray(1 - VIGNETTING * np.minimum(squared, 2))


@dataclass(frozen=True)
class Aperture:
    """A round lens.

    radius : metres; 0 is a pinhole.
    focus : depth of the sharp plane, metres.
    points : number of points that represent the lens.
    """

    radius: float = 0.0
    focus: float = 1.0
    points: int = 1

    def offsets(self) -> FloatArray:
        """Returns (points, 2), right and down, in a sunflower pattern of equal areas."""
        index = np.arange(self.points)
        distance = self.radius * np.sqrt((index + 0.5) / self.points)
        angle = index * np.pi * (3 - np.sqrt(5))
        return np.stack([distance * np.cos(angle), distance * np.sin(angle)], axis=1)


def direct_hits(
    projector: Pinhole,
    aperture: Aperture,
    points: FloatArray,
    normals: FloatArray,
    numbers: NDArray[np.int64],
    occluders: Sequence[Rectangle],
) -> Hits:
    """Returns direct light from the projector's lens on points of surfaces.

    E = flux · cosθ / (r² · solid angle of a pixel), and 0 behind an occluder. The focal plane is perpendicular to the
    projector's axis. A pixel's solid angle from any lens point is therefore proportional to cos³ of the ray's angle to
    the axis.

    points, normals : (n, 3).
    numbers : (n,). Indices of the samples.
    """
    found = []
    for right, down in aperture.offsets():
        start = projector.position + right * projector.axes[0] + down * projector.axes[1]
        local = projector.local(points)
        ahead = local[:, 2] > 0
        local, at, normal, number = local[ahead], points[ahead], normals[ahead], numbers[ahead]
        shares = aperture.focus / local[:, 2:]
        focal = np.array([right, down]) * (1 - shares) + local[:, :2] * shares
        uv = projector.pixels(np.concatenate([focal, np.full((len(focal), 1), aperture.focus)], axis=1))
        ray = start - at
        squared = np.sum(ray**2, axis=1)
        cosine = np.abs(np.sum(ray * normal, axis=1)) / np.sqrt(squared)
        # the middle of the lens represents all its points, because only the ray's direction counts
        leaving = projector.pixels(local - (right, down, 0))
        irradiance = flux(projector, uv) * cosine / (squared * projector.solid_angle(leaving)) / aperture.points
        dark = np.zeros(len(at), np.bool_)
        for occluder in occluders:
            dark |= occluder.blocks(start, at)
        found.append(Hits(number[~dark], uv[~dark], irradiance[~dark]))
    return joined(found)


def footprints(
    hits: Hits,
    samples: int,
    raster: tuple[int, int],
    shift: tuple[float, float] = (0, 0),
    sigma: float = LENS,
    scale: float = 1.0,
    margin: int = 0,
) -> sparse.csr_array:
    """Returns W, (samples, projector pixels): irradiance of each sample per pixel at full drive.

    shift : movement of the projected picture over the room, pixels right and down.
    scale : of the picture about the raster's middle, before the movement.
    margin : pixels that are added to the raster on each side.
    """
    middle = np.array(raster[::-1]) / 2
    raster = raster[0] + 2 * margin, raster[1] + 2 * margin
    total = sparse.csr_array((samples, raster[0] * raster[1]), dtype=np.float32)
    order = np.argsort(hits.sample, kind="stable")
    parts = []
    for start in range(0, order.size, CHUNK):
        some = order[start : start + CHUNK]
        uv = (hits.uv[some] - shift - middle) / scale + middle + margin
        (columns, across), (rows, down) = (_spread(uv[:, axis], raster[1 - axis], sigma) for axis in (0, 1))
        weights = (hits.irradiance[some, None] * down)[:, :, None] * across[:, None, :]
        pixels = rows[:, :, None] * raster[1] + columns[:, None, :]
        lit = weights > 0
        sample = np.broadcast_to(hits.sample[some, None, None], lit.shape)[lit]
        entries = weights[lit].astype(np.float32), (sample, pixels[lit])
        parts.append(sparse.csr_array(sparse.coo_array(entries, shape=total.shape)))
    return sum(parts, total)


def _spread(u: FloatArray, pixels: int, sigma: float) -> tuple[NDArray[np.int64], FloatArray]:
    """Returns pixels along an axis under a Gaussian around u, and shares: (n, taps) each; 0 off the raster."""
    reach = CUT * sigma
    first = np.floor(u - reach).astype(np.int64)
    edges = first[:, None] + np.arange(int(np.ceil(2 * reach)) + 2)
    inside = np.clip((edges - u[:, None]) / sigma, -CUT, CUT)
    below = (ndtr(inside) - ndtr(-CUT)) / (ndtr(CUT) - ndtr(-CUT))
    indices = edges[:, :-1]
    shares = np.diff(below, axis=1) * ((indices >= 0) & (indices < pixels))
    return np.clip(indices, 0, pixels - 1), shares

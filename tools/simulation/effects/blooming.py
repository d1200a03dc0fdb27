"""Blooming: lens and sensor scatter a share of each pixel's light into a halo around it (veiling glare, ISO 9358).

The point spread is (1 − s) δ + s h with h = exp(−d / r) / (2π r²) at a distance of d pixels. A halo reaches hundreds of
pixels and is smooth, so it is far light: T' = (1 − s) T + s V K A T. A averages the camera picture over cells, K is h
between the centres of the cells, and V interpolates. A halo narrower than a cell becomes as wide as a cell. Light that
is scattered beyond the picture is lost.
"""

from dataclasses import replace

import numpy as np
from scipy import sparse

from counterlight.arrays import FloatArray
from counterlight.tools.simulation.devices import Camera
from counterlight.tools.simulation.scene import Scene
from counterlight.tools.transport.transport import Csr, Transport, channels, far_light_of

MAX_CELLS = 1600
REACH = 8  # halo radii; 0.3 % of the halo is further out


def bloom(scene: Scene, transport: Transport, ambient: FloatArray) -> tuple[Transport, FloatArray, float]:
    """Returns T and e (camera pixels, 3) with halos, and the share of the light that moved."""
    share = scene.camera.bloom_share
    average, halo, interpolate = halo_factors(scene.camera)
    dimmed = replace(transport, far=None).by_rows(
        lambda rows: replace(rows, weights=((1 - share) * rows.weights).astype(np.float32))
    )
    collected = _collected(average, transport)
    far = transport.far
    if far is None:
        bloomed = far_light_of(collected, np.stack([halo] * 3), [share * interpolate] * 3)
    else:
        gathers, scatters = channels(far.gather), channels(far.scatter)
        gather = [Csr(sparse.vstack([D, own])) for D, own in zip(gathers, collected, strict=True)]
        mix = [_stacked(M, halo @ (average @ U) @ M, halo) for M, U in zip(far.mix.matrices, scatters, strict=True)]
        scatter = [Csr(sparse.hstack([(1 - share) * U, share * interpolate])) for U in scatters]
        bloomed = far_light_of(gather, np.stack(mix), scatter)
    spread_ambient = (1 - share) * ambient + share * (interpolate @ (halo @ (average @ ambient)))
    return replace(dimmed, far=bloomed), spread_ambient, share


def _collected(average: Csr, transport: Transport) -> list[Csr]:
    """Returns A (S + B P) per channel."""
    found = [Csr(average @ S) for S in channels(transport.near)]
    if transport.blurred is not None:
        factors = zip(channels(transport.blurred.scatter), channels(transport.blurred.gather), strict=True)
        found = [Csr(own + (average @ B) @ P) for own, (B, P) in zip(found, factors, strict=True)]
    return found


def halo_factors(camera: Camera) -> tuple[Csr, FloatArray, Csr]:
    """Returns A (cells, pixels), K (cells, cells) and V (pixels, cells)."""
    step = max(1.0, np.sqrt(camera.pixels / MAX_CELLS))
    across, along = (max(1, int(size / step)) for size in (camera.width, camera.height))
    average = sparse.kron(_average(along, camera.height), _average(across, camera.width))
    interpolate = sparse.kron(_interpolate(camera.height, along), _interpolate(camera.width, across))
    radius = np.tan(camera.bloom_radius) * camera.width / (2 * camera.tan_half[0])
    steps = camera.width / across, camera.height / along
    y, x = np.divmod(np.arange(across * along), across)
    apart = np.hypot((x[:, None] - x) * steps[0], (y[:, None] - y) * steps[1])
    return Csr(average), np.exp(-apart / radius) / _whole_halo(radius, steps), Csr(interpolate)


def _whole_halo(radius: float, steps: tuple[float, float]) -> float:
    """Returns the sum of exp(−d / r) over all cells of an infinite picture."""
    x, y = (np.arange(-n, n + 1) * step for step in steps for n in [int(np.ceil(REACH * radius / step))])
    return float(np.exp(-np.hypot(x[:, None], y) / radius).sum())


def _average(cells: int, pixels: int) -> Csr:
    """Returns the means over cells of equal length, (cells, pixels); a pixel on a cell border counts in part."""
    edges = np.linspace(0, pixels, cells + 1)
    inside = np.minimum(edges[1:, None], np.arange(1, pixels + 1)) - np.maximum(edges[:-1, None], np.arange(pixels))
    return Csr(np.maximum(inside, 0) * cells / pixels)


def _interpolate(pixels: int, cells: int) -> Csr:
    """Returns linear interpolation between the centres of the cells, (pixels, cells)."""
    place = np.clip((np.arange(pixels) + 0.5) * cells / pixels - 0.5, 0, cells - 1)
    return Csr(np.maximum(0, 1 - np.abs(place[:, None] - np.arange(cells))))


def _stacked(far: FloatArray, across: FloatArray, halo: FloatArray) -> FloatArray:
    """[[far, 0], [across, halo]]."""
    return np.block([[far, np.zeros((len(far), len(halo)))], [across, halo]])

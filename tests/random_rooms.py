"""Random rooms by ray tracing: glass bends a projector's light on its way to a textured surface and to a camera.

T = C · diag(paint) · P. P holds the light of each projector pixel on a fine grid of surface cells. C holds the cells
that each camera pixel sees. A pixel is a blurred square of rays, and each ray is shared by four cells.

Smooth displacements bend the rays: they concentrate light, spread it, fold it, or show it twice.
"""

from collections.abc import Callable

import numpy as np
from scipy import sparse

from tests.grey_rooms import GreyRoom

KINDS = ("plain", "glass", "lens", "fold", "ghost")
RATIOS = (0.6, 0.8, 1.3, 1.8, 2.5)  # camera pixels per projector pixel, along a side
RAYS = 4  # rays per pixel, along a side
CELLS = 1.6  # surface cells per pixel of the finer device, along a side
WAVES = 6

Bend = Callable[[np.ndarray], np.ndarray]


def random_room(seed: int, most_rows: int = 50) -> GreyRoom:
    """Random room; the kind cycles with the seed.

    most_rows : limit for the projector's rows; its width is at most 1.6 times as large.
    """
    rng, kind = np.random.default_rng(seed), KINDS[seed % len(KINDS)]
    height = int(rng.integers(3 * most_rows // 5, most_rows))
    projector = height, int(height * rng.uniform(0.9, 1.6))
    ratio = rng.choice(RATIOS)
    camera = round(projector[0] * ratio), round(projector[1] * ratio)
    cells = int(CELLS * max(camera[0], projector[0])), int(CELLS * max(camera[1], projector[1]))
    of_projector, of_camera = _bends(rng, kind)
    blur = rng.choice([0.3, 0.5, 0.8, 1.5])
    lit = _rays(projector, cells, blur, of_projector)
    if kind == "ghost":
        share, shift = rng.uniform(0.05, 0.25), rng.uniform(-0.2, 0.2, 2)
        again = _rays(projector, cells, 2 * blur, lambda at: of_projector(at + shift))
        lit = sparse.csr_array((1 - share) * lit + share * again)
    seen = _rays(camera, cells, rng.choice([0.3, 0.5]), of_camera)
    density = cells[0] * cells[1] / (projector[0] * projector[1])
    T = sparse.csr_array(density * (seen @ sparse.diags_array(_paint(rng, cells)) @ lit.T))
    return GreyRoom(kind, T, camera, projector, rng.uniform(0.001, 0.008))


def _bends(rng: np.random.Generator, kind: str) -> tuple[Bend, Bend]:
    """Returns maps from the projector picture and from the camera picture to the surface, in fractions of a side."""
    scale, offset = rng.uniform(0.75, 1.15), rng.uniform(-0.05, 0.05, 2)
    strength = {"glass": 0.03, "lens": 0.02, "fold": 0.05, "ghost": 0.02}.get(kind, 0.0) * rng.uniform(0.5, 1.5)
    waves = _waves(rng, strength, rng.uniform(0.1, 0.4))
    power = rng.uniform(-0.35, 0.6) if kind == "lens" else 0.0

    def of_projector(at: np.ndarray) -> np.ndarray:
        away = at - 0.5
        near = 1 - np.minimum(np.linalg.norm(away, axis=1, keepdims=True) / 0.35, 1) ** 2
        return waves(0.5 + away * (1 + power * near) * scale + offset)

    looking = {"glass": 0.02, "fold": 0.02, "ghost": 0.01}.get(kind, 0.0) * rng.uniform(0, 1.5)
    looked = _waves(rng, looking, rng.uniform(0.15, 0.5))
    zoom, aside = rng.uniform(0.8, 1.1), rng.uniform(-0.05, 0.05, 2)
    return of_projector, lambda at: looked(0.5 + (at - 0.5) * zoom + aside)


def _waves(rng: np.random.Generator, strength: float, length: float) -> Bend:
    number = rng.normal(size=(2, WAVES)) * 2 * np.pi / length
    phase, height = rng.uniform(0, 2 * np.pi, WAVES), rng.normal(size=(WAVES, 2)) * strength / np.sqrt(WAVES)
    return lambda at: at + np.sin(at @ number + phase) @ height


def _rays(pixels: tuple[int, int], cells: tuple[int, int], blur: float, bend: Bend) -> sparse.csr_array:
    """Share of each pixel's rays per cell, (pixels, cells); rays that miss the surface are dropped."""
    of_pixels = sparse.kron(*(_blurred(count, blur) for count in pixels))
    y, x = np.indices([RAYS * count for count in pixels]).reshape(2, -1)
    at = bend((np.stack([x, y], axis=1) + 0.5) / (RAYS * pixels[1], RAYS * pixels[0])) * (cells[1], cells[0]) - 0.5
    low = np.floor(at).astype(int)
    share, shape = at - low, (len(at), cells[0] * cells[1])
    shared = sparse.csr_array(shape)
    for dy, dx in ((0, 0), (0, 1), (1, 0), (1, 1)):
        column, row = low[:, 0] + dx, low[:, 1] + dy
        weight = np.abs(1 - dx - share[:, 0]) * np.abs(1 - dy - share[:, 1])
        met = (column >= 0) & (column < cells[1]) & (row >= 0) & (row < cells[0])
        place = np.flatnonzero(met), (row * cells[1] + column)[met]
        shared = shared + sparse.csr_array((weight[met], place), shape=shape)
    return sparse.csr_array(of_pixels @ shared)


def _blurred(count: int, blur: float) -> sparse.csr_array:
    """Weight of each ray in each pixel along one side, (pixels, rays); blur is in pixels."""
    places = (np.arange(RAYS * count) + 0.5) / RAYS
    away = (places - np.arange(count)[:, None] - 0.5) / np.hypot(blur, 0.3)
    weights = np.where(np.abs(away) < 3, np.exp(-(away**2) / 2), 0)
    return sparse.csr_array(weights / weights.sum(axis=1, keepdims=True))


def _paint(rng: np.random.Generator, cells: tuple[int, int]) -> np.ndarray:
    """Tiles of random reflectance, (cells,)."""
    tiles = rng.normal(0.55, 0.25, (cells[0] // 6 + 1, cells[1] // 6 + 1))
    return np.clip(np.kron(tiles, np.ones((6, 6)))[: cells[0], : cells[1]], 0.08, 0.95).ravel()

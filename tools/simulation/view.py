"""What each camera ray sees, traced once and used by every effect."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from player.command import track
from tools.simulation.geometry import pixel_rays, trace
from tools.simulation.scene import Scene, Surface

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
CHUNK_RAYS = 1 << 19


@dataclass(frozen=True)
class _Seen:
    """Rays of a band of camera rows that end on one surface: pixel, u and v, (rays,) each."""

    surface: Surface
    pixels: IntArray
    u: NDArray[np.float32]
    v: NDArray[np.float32]


class CameraView:
    """The camera's rays, samples² a pixel, sorted by band of rows and by surface."""

    def __init__(self, scene: Scene) -> None:
        self._seen: list[_Seen] = []
        height = max(1, CHUNK_RAYS // (scene.camera.width * scene.samples**2))
        starts = range(0, scene.camera.height, height)
        for top in track(starts, "tracing the camera's rays", len(starts)):
            rows = range(top, min(top + height, scene.camera.height))
            directions, pixels = pixel_rays(scene.camera, rows, scene.samples)
            hits = trace(scene.camera.position, directions, scene.surfaces)
            for index, surface in enumerate(scene.surfaces):
                on = hits.surface == index
                if on.any():
                    u, v = hits.u[on].astype(np.float32), hits.v[on].astype(np.float32)
                    self._seen.append(_Seen(surface, pixels[on], u, v))

    @property
    def empty(self) -> bool:
        return not self._seen

    def patches(self) -> Iterator[tuple[IntArray, Surface, FloatArray, FloatArray]]:
        """Camera pixels (n,), the surface they see, the points (n, 3) and their albedo (n, 3)."""
        for seen, (u, v) in zip(self._seen, self.places(), strict=True):
            yield seen.pixels, seen.surface, seen.surface.at(u, v), seen.surface.material.albedo(u, v)

    def places(self) -> Iterator[tuple[FloatArray, FloatArray]]:
        """u and v (n,) of the same rays in the same order."""
        for seen in self._seen:
            yield seen.u.astype(np.float64), seen.v.astype(np.float64)

"""Direct light: projector, matt surface, camera; shadows only if a test for them is handed in.

The projector lights a plane across its axis evenly, as real ones are built to: at depth z along the axis the irradiance
on such a plane is E⊥ = π · brightness · (z₀ / z)², z₀ the distance of look_at, so that a white card there has radiance
`brightness`. On a surface turned by θ towards a beam at α from the axis, E = E⊥ cos θ / cos α; a matt surface of
albedo ρ then has radiance ρ E / π (Lambert). A camera pixel is the mean over its rays, each of which sees one projector
pixel.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from tools.simulation.geometry import pixel_at, project
from tools.simulation.scene import Scene, Surface
from tools.simulation.view import CameraView
from tools.transport.transport import Csr

FloatArray = NDArray[np.float64]
ShadowTest = Callable[[FloatArray], NDArray[np.bool_]]


def irradiance(scene: Scene, surface: Surface, points: FloatArray) -> FloatArray:
    """Irradiance of a white projector picture at points (n, 3) of a surface, unshaded; 0 on its far side."""
    towards = points - scene.projector.position
    depth = towards @ scene.projector.forward
    distance = np.linalg.norm(towards, axis=1)
    cos_surface = np.maximum(-towards @ surface.normal / distance, 0)
    lit = depth > 0
    safe = np.where(lit, depth, 1.0)
    across = np.pi * scene.brightness * (scene.projector.target_distance / safe) ** 2
    return np.where(lit, across * cos_surface * distance / safe, 0.0)


def direct_transport(scene: Scene, view: CameraView, shadow: ShadowTest | None) -> tuple[Csr, ...]:
    """T of direct light, (camera pixels, projector pixels) float32 CSR per channel."""
    shape = scene.camera.width * scene.camera.height, scene.projector.width * scene.projector.height
    parts: list[tuple[NDArray[np.int64], NDArray[np.int64], FloatArray]] = []
    for pixels, surface, points, albedo in view.patches():
        x, y, _ = project(scene.projector, points)
        target = pixel_at(scene.projector, x, y)
        light = irradiance(scene, surface, points)
        lit = (target >= 0) & (light > 0)
        if shadow is not None:
            lit[lit] = ~shadow(points[lit])
        radiance = albedo[lit] * (light[lit] / np.pi / scene.samples**2)[:, None]
        parts.append(_summed(pixels[lit], target[lit], radiance, shape[1]))
    rows, columns, weights = (np.concatenate(part) for part in zip(*parts, strict=True))
    return tuple(sparse.csr_array((weights[:, i].astype(np.float32), (rows, columns)), shape=shape) for i in range(3))


def _summed(
    rows: NDArray[np.int64], columns: NDArray[np.int64], weights: FloatArray, width: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], FloatArray]:
    """Rays of one camera pixel on one projector pixel become one entry: memory holds entries, not rays."""
    places, inverse = np.unique(rows * width + columns, return_inverse=True)
    summed = np.stack([np.bincount(inverse, weights[:, i], places.size) for i in range(3)], axis=1).astype(np.float64)
    return np.asarray(places // width, np.int64), np.asarray(places % width, np.int64), summed

"""Crosstalk: a camera's channels see neighbouring primaries, too (thesis 4.1.1).

Light is followed primary by primary. What channel k of a camera pixel sees of it is Σ_l X_kl T_l p_l: X is the camera's
mixing of the primaries on neutral paint, times how the paint that the pixel sees reflects that overlap of spectra, as a
share of what it reflects of the primary's peak. On the way light stays in its primary: of paint that it met before,
only the albedo counts.
"""

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.maps.mixing import mixed
from counterlight.tools.simulation.paths import Samples
from counterlight.tools.simulation.scene import Scene
from counterlight.tools.transport.mixing import mixed_channels
from counterlight.tools.transport.transport import Transport


def of_samples(scene: Scene, samples: Samples) -> FloatArray:
    """X of what samples see, (n, 3, 3)."""
    ones = np.ones((3, 3))
    bands = [ones if surface.material.overlap is None else surface.material.overlap for surface in scene.surfaces]
    assert scene.camera.mixing is not None
    return np.asarray(scene.camera.mixing * np.stack(bands)[samples.surface])


def of_pixels(scene: Scene, total: FloatArray, weight: FloatArray) -> FloatArray:
    """X of every camera pixel, the mean of what it sees; where that is nothing, that of neutral paint.

    total : Σ weight X of the samples, (camera pixels, 3, 3).  weight : (camera pixels,).
    """
    seen = weight > 0
    assert scene.camera.mixing is not None
    return np.where(seen[:, None, None], total / np.where(seen, weight, 1)[:, None, None], scene.camera.mixing)


def photographed(
    X: FloatArray, transport: Transport, ambient: FloatArray
) -> tuple[Transport, FloatArray, FloatArray, float]:
    """What patterns of white light find, T_k = Σ_l X_kl T_l; ambient light; floodlights F_kl = X_kl (T_l·1).

    Returns T, e (camera pixels, 3), F (primary, camera pixels, camera channel), and the light that other channels see.
    """
    composition = transport.composition()
    F = X * composition[:, None, :]
    elsewhere = float(F.sum() - np.einsum("ill->", F))
    return mixed_channels(transport, X), np.asarray(mixed(X, ambient)), np.moveaxis(F, 2, 0), elsewhere

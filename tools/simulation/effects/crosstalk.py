"""Crosstalk: the channels of a camera also see neighbouring primaries (thesis 4.1.1).

Light is followed per primary. Channel k of a camera pixel sees Σ_l X_kl T_l p_l. X is the camera's mixing of the
primaries on neutral paint, times the reflectance of the visible paint in that overlap of spectra. That reflectance is a
share of the reflectance at the primary's peak. On the way light stays in its primary: paint that the light met before
contributes only its albedo.
"""

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.maps.mixing import mixed
from counterlight.tools.simulation.paths import Samples
from counterlight.tools.simulation.scene import Scene
from counterlight.tools.transport.mixing import mixed_channels
from counterlight.tools.transport.transport import Transport


def of_samples(scene: Scene, samples: Samples) -> FloatArray:
    """Returns X at samples, (n, 3, 3)."""
    ones = np.ones((3, 3))
    bands = [ones if surface.material.overlap is None else surface.material.overlap for surface in scene.surfaces]
    assert scene.camera.mixing is not None
    return np.asarray(scene.camera.mixing * np.stack(bands)[samples.surface])


def of_pixels(scene: Scene, total: FloatArray, weight: FloatArray) -> FloatArray:
    """Returns X of every camera pixel, the weighted mean over its samples; neutral paint where there are none.

    total : (camera pixels, 3, 3). Σ weight X of the samples.
    weight : (camera pixels,).
    """
    seen = weight > 0
    assert scene.camera.mixing is not None
    return np.where(seen[:, None, None], total / np.where(seen, weight, 1)[:, None, None], scene.camera.mixing)


def photographed(
    X: FloatArray, transport: Transport, ambient: FloatArray
) -> tuple[Transport, FloatArray, FloatArray, float]:
    """Returns the mixing as patterns of white light measure it.

    The results are T_k = Σ_l X_kl T_l, e (camera pixels, 3), the floodlights F_kl = X_kl (T_l·1) as (primary, camera
    pixels, camera channel), and the light that channels see of other primaries.
    """
    composition = transport.composition()
    F = X * composition[:, None, :]
    elsewhere = float(F.sum() - np.einsum("ill->", F))
    return mixed_channels(transport, X), np.asarray(mixed(X, ambient)), np.moveaxis(F, 2, 0), elsewhere

"""Blooming: lens and sensor scatter a share of each pixel's light into a halo around it (veiling glare, ISO 9358).

The point spread is (1 − s) δ + s h. A halo reaches hundreds of pixels and is smooth, so it is far light:
T' = (1 − s) T + s V K A T, with V, K and A of glare.py. Light that is scattered beyond the picture is lost.
"""

from dataclasses import replace

import numpy as np
from scipy import sparse

from counterlight.arrays import FloatArray
from counterlight.tools.simulation.effects.glare import halo_of
from counterlight.tools.simulation.scene import Scene
from counterlight.tools.transport.transport import Csr, Transport, channels, far_light_of


def bloom(scene: Scene, transport: Transport, ambient: FloatArray) -> tuple[Transport, FloatArray, float]:
    """Returns T and e (camera pixels, 3) with halos, and the share of the light that the halos moved."""
    share = scene.camera.bloom_share
    glare = halo_of(scene.camera, scene.camera.bloom_radius)
    average, halo, interpolate = glare.average, glare.kernel, glare.interpolate
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


def _stacked(far: FloatArray, across: FloatArray, halo: FloatArray) -> FloatArray:
    """[[far, 0], [across, halo]]."""
    return np.block([[far, np.zeros((len(far), len(halo)))], [across, halo]])

"""Halo: the projector's lens scatters a share of each pixel's light around it, also beyond the raster (ISO 9358).

The lens emits q = (1 − s) p + s V K A p instead of p, with V, K and A of glare.py. What the camera sees of each cell,
U', is traced like direct light, so that c = (1 − s) S p + U' K A p with s in U'. Indirect light M of what lands, D q,
adds (1 − s) M D p + s M D V K A p. The halo's light beyond the raster does not inter-reflect. It comes from the lens'
centre and has no lateral colour.
"""

import numpy as np
from scipy import sparse

from counterlight.arrays import FloatArray
from counterlight.maps.row_map import SparseRows
from counterlight.tools.simulation.effects.glare import Halo, halo_of
from counterlight.tools.simulation.paths import Arrivals, Samples
from counterlight.tools.simulation.projector_side import irradiance
from counterlight.tools.simulation.scene import Scene
from counterlight.tools.transport.transport import Csr, Transport, channels, far_light_of

BEYOND = 4.0  # halo radii; at this distance from the raster, white leaves 0.7 % of a halo's light


def halo_cells(scene: Scene) -> Halo:
    return halo_of(scene.projector, scene.projector.halo_radius, BEYOND)


def arrivals(scene: Scene, samples: Samples) -> list[Arrivals]:
    """Returns the halo's light at samples; an arrival's `pixel` is a cell."""
    projector, halo = scene.projector, halo_cells(scene)
    x, y, _ = projector.project(samples.point)
    light = projector.halo_share * irradiance(scene, samples.point, samples.normal)
    inside = [np.abs(at - axis.pixels / 2) < axis.cells * axis.step / 2 for at, axis in ((x, halo.x), (y, halo.y))]
    lit = np.flatnonzero(inside[0] & inside[1] & (light > 0))  # NaN is not inside
    origin = np.broadcast_to(projector.position, (lit.size, 3))
    around = halo.between(x[lit], y[lit])
    return [Arrivals(lit, cell, (light[lit] * weight)[:, None], origin, "halo") for cell, weight in around]


def scattered(scene: Scene, transport: Transport, seen: SparseRows, sent: FloatArray | None) -> Transport:
    """Returns T with the halo.

    seen : U', (camera pixels, cells).
    sent : (projector pixels,). Share of its light that each pixel sends; None for 1.
    """
    share, halo = scene.projector.halo_share, halo_cells(scene)
    average, kernel, far = halo.average, halo.kernel, transport.far
    dimmed = transport.without_far.scaled(np.full(transport.shape[0], 1 - share, np.float32))
    gather = [average if sent is None else Csr(average @ sparse.diags_array(sent))] * 3
    mix, scatter = np.stack([kernel] * 3), list(channels(seen))
    if far is not None:
        landing = [share * ((D @ halo.interpolate) @ kernel) for D in channels(far.gather)]
        gather = [Csr(sparse.vstack([D, A])) for D, A in zip(channels(far.gather), gather, strict=True)]
        mix = np.stack([_stacked(M, share, on, kernel) for M, on in zip(far.mix.matrices, landing, strict=True)])
        scatter = [Csr(sparse.hstack([U, own])) for U, own in zip(channels(far.scatter), scatter, strict=True)]
    return Transport(dimmed.near, far_light_of(gather, mix, scatter), dimmed.camera, dimmed.projector, dimmed.blurred)


def _stacked(M: FloatArray, share: float, landing: FloatArray, kernel: FloatArray) -> FloatArray:
    """[[(1 − s) M, s M D V K], [0, K]]."""
    return np.block([[(1 - share) * M, M @ landing], [np.zeros((len(kernel), len(M))), kernel]])

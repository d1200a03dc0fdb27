"""Rooms whose T is dense, written entry by entry as somebody else's measurement or path tracer would give it."""

import numpy as np
from scipy import sparse

from counterlight.tools.transport.transport import Transport
from tests.rig.light import separate
from tests.rig.rooms import corner
from tests.rig.view import Truth, View

CAMERA, PROJECTOR = (24, 32), (18, 24)
SHAPE = 24 * 32, 18 * 24


def transport(
    channels: list[np.ndarray], camera: tuple[int, int] = CAMERA, projector: tuple[int, int] = PROJECTOR
) -> Transport:
    """T of dense matrices (camera pixels, projector pixels) of three channels."""
    matrices = [sparse.csr_array(channel, dtype=np.float32) for channel in channels]
    return Transport.from_matrices(matrices, camera=camera, projector=projector)


def direct(rng: np.random.Generator) -> np.ndarray:
    """Each camera pixel sees the projector pixel that lies where it does, on a textured wall: (camera, projector)."""
    y, x = (np.arange(side) * other // side for side, other in zip(CAMERA, PROJECTOR, strict=True))
    T = np.zeros(SHAPE)
    T[np.arange(SHAPE[0]), (y[:, None] * PROJECTOR[1] + x).ravel()] = rng.uniform(0.4, 1, SHAPE[0])
    return T


def textured_glow(rng: np.random.Generator, share: float = 0.3) -> np.ndarray:
    """Far light f gᵀ / n, textures both: every pixel lights every other, the closed form that the model holds."""
    f, g = rng.uniform(0.5, 1.5, SHAPE[0]), rng.uniform(0.5, 1.5, SHAPE[1])
    return share * np.outer(f, g) / SHAPE[1]


def radiosity_corner(scale: float = 0.24) -> Transport:
    """The rig's corner with all bounces of its light between patches, no entry left out."""
    room = corner(scale)
    seen = View(Truth(room, separate()), room.lattice.calibrated()).transport()
    rows, columns = (side // 3 for side in seen.near.shape)
    assert seen.far is not None
    U, G, D = seen.far
    channels = []
    for i in range(3):
        near = sparse.csr_array(seen.near[i * rows : (i + 1) * rows, i * columns : (i + 1) * columns])
        far = (U[i * rows : (i + 1) * rows] @ G) @ D[:, i * columns : (i + 1) * columns].toarray()
        channels.append(near.toarray() + far)
    return transport(channels, room.lattice.camera, room.raster)

"""Rooms with a dense T, given entry by entry as a measurement or a path tracer would."""

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
    """T from dense matrices (camera pixels, projector pixels), one per channel."""
    matrices = [sparse.csr_array(channel, dtype=np.float32) for channel in channels]
    return Transport.from_matrices(matrices, camera=camera, projector=projector)


def direct(rng: np.random.Generator) -> np.ndarray:
    """Direct light on a textured wall, (camera, projector): each camera pixel sees one projector pixel."""
    y, x = (np.arange(side) * other // side for side, other in zip(CAMERA, PROJECTOR, strict=True))
    T = np.zeros(SHAPE)
    T[np.arange(SHAPE[0]), (y[:, None] * PROJECTOR[1] + x).ravel()] = rng.uniform(0.4, 1, SHAPE[0])
    return T


def textured_glow(rng: np.random.Generator, share: float = 0.3) -> np.ndarray:
    """Far light f gᵀ / n with textures f and g: every pixel lights every other. The model holds this form exactly."""
    f, g = rng.uniform(0.5, 1.5, SHAPE[0]), rng.uniform(0.5, 1.5, SHAPE[1])
    return share * np.outer(f, g) / SHAPE[1]


def radiosity_corner(scale: float = 0.24) -> Transport:
    """The rig's corner as a dense T, with all bounces of light between patches."""
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

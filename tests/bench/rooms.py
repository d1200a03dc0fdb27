"""Rooms of the benchmarks: synthetic, made in a second, at the thesis' sizes, with three tinted channels."""

from functools import cache

import numpy as np
from scipy import sparse

from counterlight.tools.clusters.decomposition import Decomposition, Parameters
from counterlight.tools.clusters.search import decompose_to
from counterlight.tools.transport.transport import Csr, stacked
from tests.rooms import blurred_transport

CAMERA, PROJECTOR = (480, 640), (512, 512)
MAX_CLUSTER = 200
SIDE = 5  # camera pixels per side that a projector pixel lights: 25 entries per column
BLUR = 0.7  # σ in camera pixels
UNEVEN = 0.2
FOCUS_CAMERA, FOCUS_PROJECTOR = (48, 48), (50, 54)  # 2304 camera and 2700 projector pixels, as in the thesis (4.3.3)
FOCUS_BLUR = 1.2  # σ in projector pixels


@cache
def wall() -> tuple[Csr, ...]:
    """Returns T for red, green and blue of a textured wall slightly out of focus; 25 entries per inner column."""
    rng = np.random.default_rng(1)
    rows, columns = np.divmod(np.arange(PROJECTOR[0] * PROJECTOR[1]), PROJECTOR[1])
    offset = np.arange(SIDE) - SIDE // 2
    (y, fall_y), (x, fall_x) = (
        _lit(place, CAMERA[axis] / PROJECTOR[axis], offset) for axis, place in enumerate((rows, columns))
    )
    weights = (fall_y[:, :, None] * fall_x[:, None, :]).reshape(rows.size, -1)
    weights *= rng.uniform(1 - UNEVEN, 1 + UNEVEN, weights.shape)  # otherwise the cut would follow a regular grid
    camera = (y[:, :, None] * CAMERA[1] + x[:, None, :]).reshape(rows.size, -1)
    inside = ((y >= 0) & (y < CAMERA[0]))[:, :, None] & ((x >= 0) & (x < CAMERA[1]))[:, None, :]
    inside = inside.reshape(rows.size, -1)
    projector = np.broadcast_to(np.arange(rows.size)[:, None], camera.shape)
    shape = CAMERA[0] * CAMERA[1], rows.size
    blur = sparse.csr_array((weights[inside], (camera[inside], projector[inside])), shape=shape)
    return tinted(blur, rng)


def _lit(place: np.ndarray, scale: float, offset: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns camera pixels that each projector pixel lights along one axis, and weights, (projector pixels, SIDE)."""
    middle = (place + 0.5) * scale - 0.5
    pixel = np.rint(middle).astype(np.int64)[:, None] + offset
    return pixel, np.exp(-((pixel - middle[:, None]) ** 2) / (2 * BLUR**2)) / (BLUR * np.sqrt(2 * np.pi))


@cache
def wall_decomposed() -> tuple[Parameters, Decomposition]:
    return decompose_to(stacked(wall()), CAMERA, PROJECTOR, MAX_CLUSTER)


@cache
def focus() -> tuple[Csr, ...]:
    """Returns T of 48x48 camera pixels of a projection out of focus, not decomposed."""
    rng = np.random.default_rng(2)
    return tinted(blurred_transport(rng, FOCUS_CAMERA, FOCUS_PROJECTOR, FOCUS_BLUR), rng)


def tinted(blur: Csr, rng: np.random.Generator) -> tuple[Csr, ...]:
    """Returns the blur on a surface of random colours, 0.4 to 1."""
    return tuple(
        sparse.csr_array(blur.multiply(rng.uniform(0.4, 1, (blur.shape[0], 1))), dtype=np.float32) for _ in range(3)
    )

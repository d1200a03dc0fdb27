"""Colour filters: each sensor pixel sees one colour, and its neighbours provide the other two (thesis 3.2).

The interpolation is bilinear, so that it is linear. A missing value is the mean of the two or four nearest pixels that
have it; fewer at the picture's border. Cameras may also follow edges, which T cannot express. A channel of the picture
is A_k c_k, with a sparse A_k whose rows sum to 1. A A = A: interpolation leaves an interpolated picture unchanged.
"""

from functools import lru_cache, reduce
from operator import add
from typing import TypeAlias

import numpy as np
from scipy import sparse

from counterlight.arrays import BoolArray, FloatArray
from counterlight.maps.row_map import SparseRows
from counterlight.tools.transport.transport import Csr, Transport, channels, stacked

Kernel: TypeAlias = tuple[tuple[float, ...], ...]
CROSS: Kernel = ((0.0, 0.25, 0.0), (0.25, 1.0, 0.25), (0.0, 0.25, 0.0))  # green: every second pixel
SQUARE: Kernel = (
    (0.25, 0.5, 0.25),
    (0.5, 1.0, 0.5),
    (0.25, 0.5, 0.25),
)  # red and blue: every second pixel of every second row


def filtered(mosaic: str, transport: Transport, ambient: FloatArray) -> tuple[Transport, FloatArray, float]:
    """Returns A T and A e (camera pixels, 3), and the light that interpolation moved."""
    assert transport.camera is not None
    A = interpolation(mosaic, *transport.camera)
    seen = transport.by_rows(lambda rows: _filtered(A, rows))
    moved = np.abs(seen.composition() - transport.composition()).sum() / 2
    return seen, interpolated(mosaic, ambient.reshape(*transport.camera, 3)).reshape(-1, 3), float(moved)


def interpolated(mosaic: str, picture: FloatArray) -> FloatArray:
    """Returns A c of a picture (height, width, 3)."""
    height, width = picture.shape[:2]
    A = interpolation(mosaic, height, width)
    seen = [(A[k] @ picture[..., k].ravel()).reshape(height, width) for k in range(3)]
    return np.stack(seen, axis=-1)


@lru_cache(maxsize=2)
def interpolation(mosaic: str, height: int, width: int) -> tuple[Csr, Csr, Csr]:
    """Returns A of red, green and blue, (pixels, pixels) each.

    mosaic : one of MOSAICS of devices.py.
    """
    y, x = np.indices((height, width))
    own = np.array(list(mosaic))[(2 * (y % 2) + x % 2).ravel()]
    return tuple(_means(own == colour, CROSS if colour == "G" else SQUARE, height, width) for colour in "RGB")  # type: ignore[return-value]


def _means(has: BoolArray, kernel: Kernel, height: int, width: int) -> Csr:
    """Returns the kernel-weighted means of the surrounding pixels that have a value."""
    shifts = [
        kernel[1 + down][1 + right] * sparse.kron(sparse.eye_array(height, k=down), sparse.eye_array(width, k=right))
        for down in (-1, 0, 1)
        for right in (-1, 0, 1)
    ]
    around = Csr(Csr(reduce(add, shifts)) @ sparse.diags_array(has.astype(np.float64)))
    around.eliminate_zeros()
    total: FloatArray = around.sum(axis=1)
    return Csr(sparse.diags_array(1 / np.where(total > 0, total, 1)) @ around)


def _filtered(A: tuple[Csr, Csr, Csr], light: SparseRows) -> SparseRows:
    rows = [Csr(a @ own) for a, own in zip(A, channels(light), strict=True)]
    return stacked([row.astype(light.weights.dtype) for row in rows])

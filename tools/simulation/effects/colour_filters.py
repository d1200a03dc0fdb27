"""Colour filters: each pixel of the sensor sees one colour, the other two come from its neighbours (thesis 3.2).

Bilinear, the interpolation that is linear: a missing value is the mean of the two or four nearest pixels that have it,
fewer at the picture's border. What cameras do beyond that follows edges, and is no part of a T. A channel of the
picture is then A_k c_k, A_k sparse with rows that sum to 1; A A = A: a picture that was interpolated stays as it is.
"""

from dataclasses import replace
from functools import lru_cache, reduce
from operator import add
from typing import TypeAlias

import numpy as np
from scipy import sparse

from counterlight.arrays import BoolArray, FloatArray
from counterlight.maps.row_map import SparseRows
from counterlight.tools.transport.transport import Csr, Transport, channels, stacked

Kernel: TypeAlias = tuple[tuple[float, ...], ...]
CROSS: Kernel = ((0.0, 0.25, 0.0), (0.25, 1.0, 0.25), (0.0, 0.25, 0.0))  # green, every second pixel
SQUARE: Kernel = (
    (0.25, 0.5, 0.25),
    (0.5, 1.0, 0.5),
    (0.25, 0.5, 0.25),
)  # red and blue, every second one of every second row


def filtered(mosaic: str, transport: Transport, ambient: FloatArray) -> tuple[Transport, FloatArray, float]:
    """A T and A e (camera pixels, 3), and the light that moved."""
    assert transport.camera is not None
    A = interpolation(mosaic, *transport.camera)
    far, blurred = transport.far, transport.blurred
    seen = replace(
        transport,
        near=_filtered(A, transport.near),
        far=None if far is None else replace(far, scatter=_filtered(A, far.scatter)),
        blurred=None if blurred is None else replace(blurred, scatter=_filtered(A, blurred.scatter)),
    )
    moved = np.abs(seen.composition() - transport.composition()).sum() / 2
    return seen, interpolated(mosaic, ambient.reshape(*transport.camera, 3)).reshape(-1, 3), float(moved)


def interpolated(mosaic: str, picture: FloatArray) -> FloatArray:
    """A c of a picture (height, width, 3), as the filters leave it and its neighbours fill it in."""
    height, width = picture.shape[:2]
    A = interpolation(mosaic, height, width)
    seen = [(A[k] @ picture[..., k].ravel()).reshape(height, width) for k in range(3)]
    return np.stack(seen, axis=-1)


@lru_cache(maxsize=2)
def interpolation(mosaic: str, height: int, width: int) -> tuple[Csr, Csr, Csr]:
    """A of red, green and blue, (pixels, pixels) each.  mosaic : as MOSAICS of devices.py."""
    y, x = np.indices((height, width))
    own = np.array(list(mosaic))[(2 * (y % 2) + x % 2).ravel()]
    return tuple(_means(own == colour, CROSS if colour == "G" else SQUARE, height, width) for colour in "RGB")  # type: ignore[return-value]


def _means(has: BoolArray, kernel: Kernel, height: int, width: int) -> Csr:
    """Means by a kernel of the pixels around that have a value."""
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

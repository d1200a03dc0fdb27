"""Composition and dual of T and of T⁺, the four pictures of the thesis' Figure 5.3.

Pictures are (height, width, 3), linear. T is the undecomposed transport, near and far light; T⁺ is what the player
applies, p = S⁺ (b − U M' D' b), without its clamp.
"""

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from counterlight.calibration import Calibration
from counterlight.maps import FarMaps, RoomMaps
from counterlight.reference import PreparedRows
from counterlight.row_map import RowMap, unpack
from counterlight.tools.transport.transport import Transport

FloatArray = NDArray[np.float64]


def composition(
    transport: Transport, calibration: Calibration, drive: FloatArray | None, *, ambient: bool
) -> FloatArray:
    """What the camera sees under a projector picture: c = T p + e (thesis eq. 3.11), or T p without ambient light.

    drive : p, (projector height, projector width, 3), 0..1; None for white, which gives the floodlit room.
    Returns (camera height, camera width, 3), radiance.
    """
    seen = transport.composition() if drive is None else transport.apply(drive.reshape(-1, 3))
    picture = seen.reshape(*calibration.camera.shape, 3)
    return picture + calibration.ambient if ambient else picture


def dual(transport: Transport, calibration: Calibration, light: FloatArray | None) -> FloatArray:
    """The scene from the projector's place, lit by the camera: p' = Tᵀ c' (thesis eq. 3.12); no ambient light in it.

    light : c', (camera height, camera width, 3), what the camera would project; None for white.
    Returns (projector height, projector width, 3).
    """
    c = np.ones((transport.shape[0], 3)) if light is None else light.reshape(-1, 3)
    return transport.apply_transpose(c).reshape(*calibration.projector.shape, 3)


def inverse_dual(maps: RoomMaps, light: FloatArray | None) -> FloatArray:
    """T⁺ c': what the projector must show so that the camera sees c' (thesis 5.1, Figure 5.3).

    Neither ambient light nor the clamp enters.
    light : c', (camera height, camera width, 3), radiance; None for 1, which sums the columns of T⁺ and gives the
    pattern that looks uniformly white. Times the room's white level it is drive; beyond 0..1 the room cannot do it.
    Returns (projector height, projector width, 3), drive per unit radiance.
    """
    b: FloatArray = np.ones((*maps.correction.source_shape, 3)) if light is None else light
    if maps.undo is not None:
        b = b - far_light(maps.undo, b)
    return PreparedRows(maps.correction).apply(b)


def inverse_composition(maps: RoomMaps, weight: FloatArray | None) -> FloatArray:
    """T⁺ᵀ p': the column sums of T⁺ seen in camera space, the inverse composition of Figure 5.3.

    A pixel's value says how much drive, over all projector pixels, one unit of its radiance asks for: bright where the
    surface is dark or badly lit, negative where neighbours have to make room for it.
    weight : p', (projector height, projector width, 3), counts projector pixels more or less; None for 1.
    With far light T⁺ᵀ = (I − D'ᵀ M'ᵀ Uᵀ) S⁺ᵀ.  Returns (camera height, camera width, 3), drive per unit radiance.
    """
    p = np.ones((*maps.correction.output_shape, 3)) if weight is None else weight
    sums = transposed(maps.correction, p)
    if maps.undo is None:
        return sums
    undo = maps.undo
    return sums - transposed(undo.gather, transposed(undo.mix, transposed(undo.scatter, sums)))


def transposed(packed: RowMap, picture: FloatArray) -> FloatArray:
    """Aᵀ x of a row map A, channel by channel: its output's picture -> its source's."""
    rows = unpack(packed)
    height, width = packed.source_shape
    shape = rows.indptr.size - 1, height * width
    sums = np.empty((height * width, 3))
    for i, weights in enumerate(rows.weights.T):
        matrix = sparse.csr_array((weights.astype(np.float64), rows.indices, rows.indptr), shape=shape)
        sums[:, i] = matrix.T @ picture[..., i].ravel()
    return sums.reshape(height, width, 3)


def far_light(maps: FarMaps, picture: FloatArray) -> FloatArray:
    """U M D x: gather, mix, scatter."""
    for packed in (maps.gather, maps.mix, maps.scatter):
        picture = PreparedRows(packed).apply(picture)
    return picture

"""The maps that refinement needs beside T (player/refinement.py): Tᵀ, step sizes, direct mapping to start from."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from counterlight.calibration import Calibration
from counterlight.colour import LUMINANCE
from counterlight.maps import FarMaps, RefinementMaps
from counterlight.row_map import SparseRows, pack
from counterlight.tools.packing.row_maps import pack_matrices
from counterlight.tools.transport.transport import Csr, Transport, shared_pattern

FloatArray = NDArray[np.float64]
FAINTEST = 1e-12  # of the largest: a projector pixel whose TᵀT·1 is below lights nothing, and its step would overflow


def refinement_maps(transport: Transport, calibration: Calibration) -> RefinementMaps:
    """Pack Tᵀ of the camera pixels inside the mask, and what refinement starts and steps with."""
    camera, projector = calibration.camera.shape, calibration.projector.shape
    inside = calibration.mask.ravel()
    dual = [_transposed(T, inside) for T in transport.near]
    floodlight = transport.composition()
    return RefinementMaps(
        pack_matrices(dual, projector, camera),
        _far_dual(transport, inside, camera, projector),
        pack(_direct_mapping(dual, floodlight), projector, camera),
        _step_size(transport.apply_transpose(floodlight * inside[:, None])).reshape(*projector, 3),
    )


def _far_dual(
    transport: Transport, inside: NDArray[np.bool_], camera: tuple[int, int], projector: tuple[int, int]
) -> FarMaps | None:
    far = transport.far
    if far is None:
        return None
    cells = 1, far.mix.shape[1]
    return FarMaps(
        pack_matrices([_transposed(U, inside) for U in far.scatter], cells, camera),
        pack_matrices([Csr(M.T) for M in far.mix], cells, cells),
        pack_matrices([Csr(D.T) for D in far.gather], projector, cells),
    )


def _transposed(matrix: Csr, kept_rows: NDArray[np.bool_]) -> Csr:
    kept = matrix.data * np.repeat(kept_rows, np.diff(matrix.indptr))
    result = Csr(sparse.csr_array((kept, matrix.indices, matrix.indptr), shape=matrix.shape).T)
    result.eliminate_zeros()
    return result


def _direct_mapping(dual: Sequence[Csr], floodlight: FloatArray) -> SparseRows:
    """p_j = b_i / (T·1)_i at the camera pixel i that projector pixel j lights most (thesis 6.1).

    dual : near Tᵀ, (projector pixels, camera pixels).  floodlight : T·1, (camera pixels, 3).
    """
    indptr, indices, weights = shared_pattern(dual)
    rows = np.repeat(np.arange(indptr.size - 1), np.diff(indptr))
    order = np.lexsort((weights @ np.array(LUMINANCE), rows))
    strongest = order[np.append(np.diff(rows[order]) != 0, True)[: order.size]]
    chosen = indices[strongest]
    light = floodlight[chosen]
    inverse = np.divide(1.0, light, out=np.zeros_like(light), where=light > FAINTEST * floodlight.max(initial=0.0))
    starts = np.searchsorted(rows[strongest], np.arange(indptr.size))
    return SparseRows(starts.astype(np.int64), chosen, inverse.astype(np.float32))


def _step_size(d: FloatArray) -> NDArray[np.float32]:
    """1 / d; 0 where nothing is lit."""
    return np.divide(1.0, d, out=np.zeros_like(d), where=d > FAINTEST * d.max(initial=0.0)).astype(np.float32)

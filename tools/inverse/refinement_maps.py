"""Packing of far light, and of what refinement needs beside T (pipeline/refinement.py): Tᵀ, step sizes, a start."""

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray
from counterlight.calibration import Calibration
from counterlight.maps.room_maps import FarMaps, RefinementMaps
from counterlight.maps.row_map import RowMap, SparseRows, pack
from counterlight.tools.transport.transport import FarLight, Transport, dense_rows, luminance

FAINTEST = 1e-12  # of the largest: a projector pixel whose TᵀT·1 is below lights nothing, and its step would overflow


def pack_far(far: FarLight, output: tuple[int, int], source: tuple[int, int], scatter: RowMap | None = None) -> FarMaps:
    """U M D from a picture of `source` to one of `output`, (height, width); scatter : U, if it is packed already."""
    cells = 1, far.cells
    return FarMaps(
        pack(far.gather, cells, source),
        pack(dense_rows(far.mix), cells, cells),
        pack(far.scatter, output, cells) if scatter is None else scatter,
    )


def refinement_maps(transport: Transport, calibration: Calibration) -> RefinementMaps:
    """Pack Tᵀ of the camera pixels inside the mask, and what refinement starts and steps with."""
    camera, projector = calibration.camera.shape, calibration.projector.shape
    dual, composition = transport.inside(calibration.mask).T, transport.composition()
    return RefinementMaps(
        pack(dual.near, projector, camera),
        None if dual.far is None else pack_far(dual.far, projector, camera),
        pack(_direct_mapping(dual.near, composition), projector, camera),
        _step_size(dual.apply(composition)).reshape(*projector, 3),
    )


def _direct_mapping(dual: SparseRows, composition: FloatArray) -> SparseRows:
    """p_j = b_i / (T·1)_i at the camera pixel i that projector pixel j lights most (thesis 6.1).

    dual : near Tᵀ, (projector pixels, camera pixels).  composition : T·1, (camera pixels, 3).
    """
    rows = dual.rows
    order = np.lexsort((luminance(dual.weights), rows))
    strongest = order[np.append(np.diff(rows[order]) != 0, True)[: order.size]]
    chosen = dual.indices[strongest]
    light = composition[chosen]
    inverse = np.divide(1.0, light, out=np.zeros_like(light), where=light > FAINTEST * composition.max(initial=0.0))
    starts = np.searchsorted(rows[strongest], np.arange(dual.indptr.size))
    return SparseRows(starts, chosen, inverse.astype(np.float32), dual.columns)


def _step_size(d: FloatArray) -> NDArray[np.float32]:
    """1 / d; 0 where nothing is lit."""
    return np.divide(1.0, d, out=np.zeros_like(d), where=d > FAINTEST * d.max(initial=0.0)).astype(np.float32)

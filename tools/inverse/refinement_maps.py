"""Packing of far light, and of what refinement needs beside T (pipeline/refinement.py): TᵀW, steps, prior, a start."""

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.maps.prior import Prior
from counterlight.maps.room_maps import FarMaps, RefinementMaps
from counterlight.maps.row_map import RowMap, SparseRows, pack
from counterlight.tools.transport.objective import FAINTEST, Objective
from counterlight.tools.transport.transport import FarLight, dense_rows, luminance


def pack_far(far: FarLight, output: tuple[int, int], source: tuple[int, int], scatter: RowMap | None = None) -> FarMaps:
    """U M D from a picture of `source` to one of `output`, (height, width); scatter : U, if it is packed already."""
    cells = 1, far.cells
    return FarMaps(
        pack(far.gather, cells, source),
        pack(dense_rows(far.mix), cells, cells),
        pack(far.scatter, output, cells) if scatter is None else scatter,
    )


def refinement_maps(objective: Objective, camera: tuple[int, int], projector: tuple[int, int]) -> RefinementMaps:
    """Pack TᵀW, and what refinement starts and steps with; camera, projector : (height, width)."""
    dual, composition, prior = objective.dual, objective.T.composition(), objective.prior
    return RefinementMaps(
        pack(dual.near, projector, camera),
        None if dual.far is None else pack_far(dual.far, projector, camera),
        pack(_direct_mapping(dual.near, composition, objective.heard), projector, camera),
        objective.step_size.astype(np.float32).reshape(*projector, 3),
        Prior.none(projector) if prior is None else prior,
        objective.weights.astype(np.float32).reshape(camera),
        objective.seen.astype(np.float32).reshape(projector),
    )


def _direct_mapping(dual: SparseRows, composition: FloatArray, heard: FloatArray) -> SparseRows:
    """p_j = b_i / (T·1)_i at the camera pixel i that projector pixel j lights most (thesis 6.1).

    dual : near TᵀW, (projector pixels, camera pixels).  composition : T·1, (camera pixels, 3).  heard : (projector
    pixels, 3), what is left of it beside the prior.
    """
    rows = dual.rows
    order = np.lexsort((luminance(dual.weights), rows))
    strongest = order[np.append(np.diff(rows[order]) != 0, True)[: order.size]]
    chosen = dual.indices[strongest]
    light = composition[chosen]
    inverse = np.divide(1.0, light, out=np.zeros_like(light), where=light > FAINTEST * composition.max(initial=0.0))
    inverse = inverse * heard[rows[strongest]]
    starts = np.searchsorted(rows[strongest], np.arange(dual.indptr.size))
    return SparseRows(starts, chosen, inverse.astype(np.float32), dual.columns)

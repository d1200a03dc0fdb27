"""Packing of far light, and of what refinement needs beside T (pipeline/refinement.py): TᵀW, steps, prior, a start."""

import numpy as np

from counterlight.maps.prior import Prior
from counterlight.maps.room_maps import FarMaps, RefinementMaps
from counterlight.maps.row_map import RowMap, pack
from counterlight.tools.inverse.direct import direct_mapping
from counterlight.tools.transport.objective import Objective
from counterlight.tools.transport.transport import FarLight, dense_rows


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
        pack(direct_mapping(dual.near, composition, objective.heard), projector, camera),
        objective.step_size.astype(np.float32).reshape(*projector, 3),
        Prior.none(projector) if prior is None else prior,
        objective.weights.astype(np.float32).reshape(camera),
        objective.seen.astype(np.float32).reshape(projector),
    )

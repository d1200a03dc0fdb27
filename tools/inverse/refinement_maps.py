"""Packing of far and blurred light, and of what refinement needs beside T: TᵀW, steps, a prior, and a start."""

from dataclasses import replace

import numpy as np

from counterlight.maps.prior import Prior
from counterlight.maps.room_maps import BlurredMaps, FarMaps, RefinementMaps
from counterlight.maps.row_map import RowMap, SparseRows, pack
from counterlight.tools.inverse.direct import direct_mapping
from counterlight.tools.transport.blurred import BlurredLight
from counterlight.tools.transport.objective import Objective
from counterlight.tools.transport.transport import FarLight, dense_rows

CELLS_ACROSS = 4096  # of the picture that cells of blurred light fill


def pack_far(far: FarLight, output: tuple[int, int], source: tuple[int, int], scatter: RowMap | None = None) -> FarMaps:
    """U M D from a picture of `source` to one of `output`, (height, width); scatter : U, if it is packed already."""
    cells = 1, far.cells
    return FarMaps(
        pack(far.gather, cells, source),
        pack(dense_rows(far.mix), cells, cells),
        pack(far.scatter, output, cells) if scatter is None else scatter,
    )


def pack_blurred(blurred: BlurredLight, output: tuple[int, int], source: tuple[int, int]) -> BlurredMaps:
    """B P, or Pᵀ Bᵀ, from a picture of `source` to one of `output`; the cells fill a picture, its last line up."""
    across = min(blurred.scatter.columns, CELLS_ACROSS)
    cells = -(-blurred.scatter.columns // across), across
    return BlurredMaps(
        pack(_with_rows(blurred.gather, cells[0] * across), cells, source), pack(blurred.scatter, output, cells)
    )


def _with_rows(rows: SparseRows, count: int) -> SparseRows:
    """With empty rows at the end."""
    return replace(rows, indptr=np.pad(rows.indptr, (0, count - rows.shape[0]), mode="edge"))


def refinement_maps(objective: Objective, camera: tuple[int, int], projector: tuple[int, int]) -> RefinementMaps:
    """Pack TᵀW, and what refinement starts and steps with; camera, projector : (height, width)."""
    dual, composition, prior = objective.dual, objective.T.composition(), objective.prior
    return RefinementMaps(
        pack(dual.near, projector, camera),
        None if dual.far is None else pack_far(dual.far, projector, camera),
        pack(direct_mapping(dual, composition, objective.heard), projector, camera),
        objective.step_size.astype(np.float32).reshape(*projector, 3),
        Prior.none(projector) if prior is None else prior,
        objective.weights.astype(np.float32).reshape(camera),
        objective.seen.astype(np.float32).reshape(projector),
        None if dual.blurred is None else pack_blurred(dual.blurred, projector, camera),
    )

"""Packs far and blurred light, and the inputs of refinement besides T: TᵀW, step sizes, a prior, and a start."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from counterlight.maps.prior import Prior
from counterlight.maps.room_maps import BlurredMaps, FarMaps, RefinementMaps
from counterlight.maps.row_map import MAX_TEXTURE_WIDTH, RowMap, SparseRows, pack
from counterlight.tools.inverse.direct import direct_mapping
from counterlight.tools.transport.blurred import BlurredLight
from counterlight.tools.transport.objective import Objective
from counterlight.tools.transport.transport import FarLight, dense_rows

CELLS_ACROSS = 4096  # width of the picture that the cells of blurred light fill


def pack_far(far: FarLight, output: tuple[int, int], source: tuple[int, int], scatter: RowMap | None = None) -> FarMaps:
    """Pack U M D as a map from `source` to `output`, (height, width) each. scatter : U, if already packed."""
    gather, cell_of = _in_parts(far.gather)
    parts, cells = (1, cell_of.size), (1, far.cells)
    return FarMaps(
        pack(gather, parts, source),
        pack(dense_rows(far.mix[..., cell_of]), cells, parts),
        pack(far.scatter, output, cells) if scatter is None else scatter,
    )


def _in_parts(rows: SparseRows) -> tuple[SparseRows, NDArray[np.int64]]:
    """Split rows longer than a texture's width into equal parts; returns the parts and each part's row."""
    counts = np.maximum(1, -(-rows.lengths // MAX_TEXTURE_WIDTH))
    row_of = np.repeat(np.arange(rows.shape[0]), counts)
    number = np.arange(row_of.size) - np.repeat(np.cumsum(counts) - counts, counts)
    begins = rows.indptr[row_of] + number * rows.lengths[row_of] // counts[row_of]
    return replace(rows, indptr=np.append(begins, rows.indptr[-1])), row_of


def pack_blurred(blurred: BlurredLight, output: tuple[int, int], source: tuple[int, int]) -> BlurredMaps:
    """Pack B P, or Pᵀ Bᵀ, as maps from `source` to `output`. Cells fill a picture; its last line is padded."""
    gather, cell_of = _in_parts(blurred.gather)
    scatter = _of_parts(blurred.scatter, cell_of)
    across = min(scatter.columns, CELLS_ACROSS)
    cells = -(-scatter.columns // across), across
    return BlurredMaps(pack(_with_rows(gather, cells[0] * across), cells, source), pack(scatter, output, cells))


def _of_parts(rows: SparseRows, cell_of: NDArray[np.int64]) -> SparseRows:
    """Replace each cell that rows read by all its parts. cell_of : (parts,), ascending; the cell of each part."""
    if cell_of.size == rows.columns:  # every cell has one part: no copy needed
        return rows
    counts = np.bincount(cell_of, minlength=rows.columns)
    first, read = np.cumsum(counts) - counts, counts[rows.indices]
    entry = np.repeat(np.arange(rows.indices.size), read)
    number = np.arange(entry.size) - np.repeat(np.cumsum(read) - read, read)
    indices = (first[rows.indices[entry]] + number).astype(np.int32)
    indptr = np.concatenate([[0], np.cumsum(read)])[rows.indptr]
    return SparseRows(indptr, indices, rows.weights[entry], cell_of.size)


def _with_rows(rows: SparseRows, count: int) -> SparseRows:
    """Append empty rows."""
    return replace(rows, indptr=np.pad(rows.indptr, (0, count - rows.shape[0]), mode="edge"))


def refinement_maps(objective: Objective, camera: tuple[int, int], projector: tuple[int, int]) -> RefinementMaps:
    """Pack TᵀW and the other inputs of refinement. camera, projector : (height, width)."""
    dual, composition, prior = objective.dual, objective.T.composition(), objective.prior
    return RefinementMaps(
        pack(dual.near, projector, camera),
        None if dual.far is None else pack_far(dual.far, projector, camera),
        pack(direct_mapping(dual, composition, objective.heard), projector, camera),
        objective.step_size.astype(np.float32).reshape(*projector, 3),
        Prior.none(projector) if prior is None else prior,
        objective.weights.astype(np.float32).reshape(camera),
        objective.seen.astype(np.float32).reshape(projector),
        (objective.weights > 0 if objective.lit is None else objective.lit).astype(np.float32).reshape(camera),
        None if dual.blurred is None else pack_blurred(dual.blurred, projector, camera),
    )

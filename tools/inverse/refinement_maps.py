"""Packs chains, and the inputs of refinement besides T: TᵀW, step sizes, a prior, and a start."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from counterlight.maps.chain import Chain
from counterlight.maps.prior import Prior
from counterlight.maps.room_maps import MapChain, RefinementMaps
from counterlight.maps.row_map import MAX_TEXTURE_WIDTH, RowMap, SparseRows, pack
from counterlight.tools.inverse.direct import direct_mapping
from counterlight.tools.transport.objective import Objective
from counterlight.tools.transport.transport import LightChain, dense_rows

CELLS_ACROSS = 4096  # width of the picture that the cells of blurred light fill


def pack_chain(
    chain: LightChain | None, output: tuple[int, int], source: tuple[int, int], scatter: RowMap | None = None
) -> MapChain | None:
    """Pack U M D or B P, if any, as maps from `source` to `output`, (height, width) each.

    Parts and cells of far light have height 1. A cell has one part, or several if more pixels than a texture's width
    are gathered into it. Blurred light has parts instead of cells, which fill a picture by lines; the last is padded.

    scatter : U, if already packed.
    """
    if chain is None:
        return None
    gather, cell_of = _in_parts(chain.gather)
    if chain.mix is None:
        rows = _of_parts(chain.scatter, cell_of)
        across = min(rows.columns, CELLS_ACROSS)
        parts = cells = -(-rows.columns // across), across
        gather, mix = _with_rows(gather, cells[0] * across), None
    else:
        rows, parts, cells = chain.scatter, (1, cell_of.size), (1, chain.scatter.columns)
        mix = pack(dense_rows(chain.mix.matrices[..., cell_of]), cells, parts)
    return Chain(pack(gather, parts, source), mix, pack(rows, output, cells) if scatter is None else scatter)


def _in_parts(rows: SparseRows) -> tuple[SparseRows, NDArray[np.int64]]:
    """Split rows longer than a texture's width into equal parts; returns the parts and each part's row."""
    counts = np.maximum(1, -(-rows.lengths // MAX_TEXTURE_WIDTH))
    row_of = np.repeat(np.arange(rows.shape[0]), counts)
    number = np.arange(row_of.size) - np.repeat(np.cumsum(counts) - counts, counts)
    begins = rows.indptr[row_of] + number * rows.lengths[row_of] // counts[row_of]
    return replace(rows, indptr=np.append(begins, rows.indptr[-1])), row_of


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
        pack_chain(dual.far, projector, camera),
        pack(direct_mapping(dual, composition, objective.data_share), projector, camera),
        objective.step_size.astype(np.float32).reshape(*projector, 3),
        Prior.none(projector) if prior is None else prior,
        objective.weights.astype(np.float32).reshape(camera),
        objective.seen.astype(np.float32).reshape(projector),
        pack_chain(dual.blurred, projector, camera),
    )

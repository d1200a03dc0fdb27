"""A part of the inverse as entries; parts come from clusters and windows and are joined into one set of sparse rows."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from player.errors import InputError
from player.row_map import SparseRows
from tools.inverse.truncation import entries_to_keep

FLOAT32_MAX = float(np.finfo(np.float32).max)


@dataclass(frozen=True)
class Piece:
    """Entries of T⁺: rows (projector pixels), columns (camera pixels), weights (entries, 3) float32.

    dropped : (distinct rows,) the certified change per row of `dropped_rows`.
    """

    rows: NDArray[np.int64]
    columns: NDArray[np.int64]
    weights: NDArray[np.float32]
    dropped_rows: NDArray[np.int64]
    dropped: NDArray[np.float64]


def truncated_piece(
    rows: NDArray[np.int64],
    columns: NDArray[np.int64],
    blocks: NDArray[np.float64],
    reach: NDArray[np.float64],
    budget: float,
) -> Piece:
    """Turn dense rows of T⁺ into entries, dropping what the budget allows.

    rows : (n,).  columns : (n, m), each row's camera pixels.  blocks : (3, n, m), red, green and blue.
    reach : (camera pixels, 3), the largest |c − e| of a picture.
    """
    products = np.max([np.abs(block) * reach[columns, i] for i, block in enumerate(blocks)], axis=0)
    keep, dropped = entries_to_keep(products, budget)
    i, j = np.nonzero(keep)
    largest = np.max(np.abs(blocks), axis=(0, 2), initial=0.0)
    if not largest.max(initial=0.0) <= FLOAT32_MAX:  # NaN, too
        worst = int(np.argmax(np.where(np.isfinite(largest), largest, np.inf)))
        raise InputError(
            f"projector pixel {rows[worst]}: its weights in T⁺ are beyond float32; the light that it sends is too "
            f"faint (about {1 / largest[worst]:.0e}); draw a mask that leaves its camera pixels out"
        )
    weights = np.stack([block[i, j] for block in blocks], axis=1).astype(np.float32)
    return Piece(rows[i], columns[i, j], weights, rows, dropped)


def join(pieces: Iterable[Piece], row_count: int) -> tuple[SparseRows, NDArray[np.float64]]:
    """All pieces as sparse rows, columns ascending, and the certified change of each row in drive."""
    parts = list(pieces)
    rows = np.concatenate([part.rows for part in parts]) if parts else np.empty(0, np.int64)
    columns = np.concatenate([part.columns for part in parts]) if parts else np.empty(0, np.int64)
    weights = np.concatenate([part.weights for part in parts]) if parts else np.empty((0, 3), np.float32)
    order = np.lexsort((columns, rows))
    indptr = np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=row_count))])
    dropped = np.zeros(row_count)
    for part in parts:
        dropped[part.dropped_rows] = part.dropped
    return SparseRows(indptr, columns[order], weights[order]), dropped

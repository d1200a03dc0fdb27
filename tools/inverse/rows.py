"""Parts of the inverse as entries. Clusters and windows produce parts, which are joined into sparse rows."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray, IntArray
from counterlight.errors import InputError
from counterlight.maps.row_map import SparseRows

FLOAT32_ROUNDING = 2.0**-24  # relative rounding of a weight
FLOAT32_MAX = float(np.finfo(np.float32).max)


@dataclass(frozen=True)
class Truncation:
    """Limits of truncation.

    reach : (camera pixels, 3). Largest |c − e| of a picture.
    budget : allowed change of a pixel, in drive.
    """

    reach: FloatArray
    budget: float


@dataclass(frozen=True)
class Piece:
    """Whole rows of T⁺.

    rows : (n,). Projector pixels, each once.
    lengths : (n,). Entries of each row.
    columns : (entries,). Camera pixels, ascending in a row.
    weights : (entries, 3) float32.
    changed : (n, 3). Certified change by truncation and rounding, in drive.
    residual : (n,). ‖N x − 1‖₁ of the row's window in the worst channel; 0 for a whole cluster.
    halo : halo of the window; 0 for a whole cluster.
    """

    rows: IntArray
    lengths: IntArray
    columns: NDArray[np.int32]
    weights: NDArray[np.float32]
    changed: FloatArray
    residual: FloatArray
    halo: int


@dataclass(frozen=True)
class Joined:
    """All pieces as sparse rows, with the change and the residual of each row."""

    rows: SparseRows
    changed: FloatArray
    residual: FloatArray


def truncated_piece(
    rows: IntArray,
    columns: IntArray,
    blocks: FloatArray,
    truncation: Truncation,
    residual: FloatArray | None = None,
    halo: int = 0,
) -> Piece:
    """Convert dense rows of T⁺ to float32 entries, dropping what the budget allows.

    The change of a row is Σ |exact − stored| · u over dropped and rounded entries. Rounding is counted first. The
    budget therefore holds, unless a row's weights cancel so strongly that rounding alone exceeds it.

    rows : (k, n). Projector pixels of k blocks of one shape.
    columns : (k, m). Camera pixels, ascending.
    blocks : (3, k, n, m). Red, green and blue.
    residual : (k · n,).

    Raises InputError if a weight is beyond float32.
    """
    k, n = rows.shape
    reach = np.moveaxis(truncation.reach[columns], -1, 0)[:, :, None]
    products = (np.abs(blocks) * reach).reshape(3, k * n, -1)
    rows, blocks = rows.ravel(), blocks.reshape(products.shape)
    largest = products.max(axis=0)
    rounding = FLOAT32_ROUNDING * largest.sum(axis=1)
    keep = entries_to_keep(largest, np.maximum(truncation.budget - rounding, 0.0))
    i, j = np.nonzero(keep)
    exact = blocks[:, i, j].T
    _refuse_overflow(rows, blocks)
    weights = exact.astype(np.float32)
    camera = columns[i // n, j]
    rounded = np.abs(exact - weights) * truncation.reach[camera]
    changed = [
        np.where(keep, 0.0, product).sum(axis=1) + np.bincount(i, rounded[:, channel], rows.size)
        for channel, product in enumerate(products)
    ]
    lengths = np.bincount(i, minlength=rows.size).astype(np.int64)
    residual = np.zeros(rows.size) if residual is None else residual
    return Piece(rows, lengths, camera.astype(np.int32), weights, np.stack(changed, axis=1), residual, halo)


def _refuse_overflow(rows: IntArray, blocks: FloatArray) -> None:
    largest = np.max(np.abs(blocks), axis=(0, 2), initial=0.0)
    if not largest.max(initial=0.0) <= FLOAT32_MAX:  # this form also catches NaN
        worst = int(np.argmax(np.where(np.isfinite(largest), largest, np.inf)))
        raise InputError(
            f"projector pixel {rows[worst]}: its weights in T⁺ are beyond float32; the light that it sends is too "
            f"faint (about {1 / largest[worst]:.0e}); draw a mask that leaves its camera pixels out"
        )


def join(pieces: Sequence[Piece], shape: tuple[int, int]) -> Joined:
    """Join pieces to sparse rows of T⁺, (projector pixels, camera pixels); rows without a piece are empty."""
    row_count, columns = shape
    lengths = np.zeros(row_count, np.int64)
    changed, residual = np.zeros((row_count, 3)), np.zeros(row_count)
    for piece in pieces:
        lengths[piece.rows], changed[piece.rows], residual[piece.rows] = piece.lengths, piece.changed, piece.residual
    indptr = np.concatenate([[0], np.cumsum(lengths)])
    indices, weights = np.empty(indptr[-1], np.int32), np.empty((indptr[-1], 3), np.float32)
    for piece in pieces:
        first = np.cumsum(piece.lengths) - piece.lengths
        place = np.repeat(indptr[piece.rows] - first, piece.lengths) + np.arange(piece.columns.size)
        indices[place], weights[place] = piece.columns, piece.weights
    return Joined(SparseRows(indptr, indices, weights, columns), changed, residual)


def entries_to_keep(products: FloatArray, budget: FloatArray | float) -> NDArray[np.bool_]:
    """Return which entries of each row stay, (rows, columns): the smallest are dropped while their sum fits the budget.

    products : (rows, columns). |T⁺_ij| · u_j, with u_j the largest |c_j − e_j|.
    budget : (rows,) or a scalar. Largest change of a row's result, in drive.

    Equal products are dropped or kept together.
    """
    ascending = np.sort(products, axis=1)
    fit = np.count_nonzero(np.cumsum(ascending, axis=1) <= np.reshape(budget, (-1, 1)), axis=1)
    ascending = np.concatenate([ascending, np.full((len(products), 1), np.inf)], axis=1)
    first_kept = ascending[np.arange(len(products)), fit]
    return np.asarray((products >= first_kept[:, None]) & (products > 0))

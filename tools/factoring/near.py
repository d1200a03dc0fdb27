"""Split T into near light above a model of its far light, and the model's factors, with T·1 unchanged."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from counterlight.maps.row_map import SparseRows
from counterlight.tools.factoring import passes
from counterlight.tools.factoring.model import Model, Rows
from counterlight.tools.transport.transport import Transport

MOST_SCALED = 2.0  # largest factor by which a row of U may grow or shrink
FAINTEST = 1e-6  # share of a row's light; below it is float32 rounding, not missed light


def split(rows: Rows, model: Model) -> Transport:
    """Split T into S + U M D: S holds the entries that exceed the model by its limit; U's rows are scaled to keep T·1.

    A row whose far light needs a scale beyond MOST_SCALED keeps all its entries and has no far light.
    """
    whole = rows.transport.composition()
    keep = passes.beyond(*passes.operands(rows.near), rows.relative, model.limit, *model.textures, *model.grids)
    far = model.far_light()
    shone = far.apply(np.ones((rows.near.shape[1], 3)))
    near = _above(rows.near.where(keep), model) if rows.relative else rows.near.where(keep)
    rest = whole - near.sums()
    scale = np.divide(rest, shone, out=np.zeros_like(shone), where=shone > 0)
    astray = (rest > FAINTEST * whole) & ((scale < 1 / MOST_SCALED) | (scale > MOST_SCALED))
    if rows.relative:
        which = np.asarray(astray.any(axis=1))
        near = _whole_rows(rows.near, near, which)
        scale[which] = 0
    scale = np.maximum(scale, 0)
    return replace(rows.transport, near=near, far=replace(far, scatter=far.scatter.scaled(scale)))


def _above(near: SparseRows, model: Model) -> SparseRows:
    """Subtract the model at the same places; ≥ 0."""
    entries = passes.operands(near)
    below = passes.explained(*entries[:2], *model.textures, *model.grids)
    return replace(near, weights=np.maximum(near.weights - below, 0).astype(near.weights.dtype))


def _whole_rows(full: SparseRows, near: SparseRows, which: NDArray[np.bool_]) -> SparseRows:
    """Replace some rows of `near` by the rows of `full`; `which` is (camera pixels,)."""
    if not which.any():
        return near
    kept, added = near.where(~which[near.rows]), full.where(which[full.rows])
    rows = np.concatenate([kept.rows, added.rows])
    order = np.argsort(rows, kind="stable")
    return SparseRows(
        kept.indptr + added.indptr,
        np.concatenate([kept.indices, added.indices])[order],
        np.concatenate([kept.weights, added.weights])[order],
        near.columns,
    )

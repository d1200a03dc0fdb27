"""Direct mapping as rows: each projector pixel uses the one camera pixel that it lights most (thesis 6.1)."""

import numpy as np

from counterlight.arrays import FloatArray, IntArray
from counterlight.maps.row_map import SparseRows
from counterlight.tools.transport.objective import FAINTEST
from counterlight.tools.transport.transport import Transport, luminance


def direct_mapping(dual: Transport, composition: FloatArray, heard: FloatArray) -> SparseRows:
    """Return rows for p_j = b_i / (T·1)_i at the camera pixel i that projector pixel j lights most, without far light.

    dual : TᵀW, (projector pixels, camera pixels).
    composition : T·1, (camera pixels, 3).
    heard : (projector pixels, 3). Factor that accounts for the prior, d / (d + η).
    """
    most = lit_most(dual)
    asking = np.flatnonzero(most >= 0)
    light = composition[most[asking]]
    inverse = np.divide(1.0, light, out=np.zeros(light.shape), where=light > FAINTEST * composition.max(initial=0.0))
    inverse = inverse * heard[asking]
    starts = np.searchsorted(asking, np.arange(dual.shape[0] + 1))
    return SparseRows(starts, most[asking].astype(np.int32), inverse, dual.shape[1])


def lit_most(dual: Transport) -> IntArray:
    """Return the camera pixel that each projector pixel lights most, or −1: (projector pixels,).

    dual : Tᵀ; its far light is ignored.
    """
    strength, chosen = _largest(dual.near, luminance(dual.near.weights))
    most = np.where(chosen >= 0, np.append(dual.near.indices, -1)[chosen], -1)
    if dual.blurred is None:
        return most
    # A camera pixel sees a projector pixel through one entry or through one cell, never both, so the largest value
    # decides.
    cells, means = dual.blurred.gather, dual.blurred.scatter
    of_cell, entry = _largest(cells, luminance(cells.weights))
    through, cell = _largest(means, luminance(means.weights) * of_cell[means.indices])
    wide = np.append(cells.indices, -1)[entry[np.append(means.indices, 0)[cell]]]
    return np.where(through > strength, wide, most)


def _largest(rows: SparseRows, strength: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return each row's largest strength and the last entry that has it; 0 and −1 for empty rows.

    strength : (entries,).
    """
    at, count = rows.rows, rows.shape[0]
    largest, last = np.zeros(count), np.full(count, -1)
    np.maximum.at(largest, at, strength)
    candidates = np.flatnonzero(strength == largest[at])
    np.maximum.at(last, at[candidates], candidates)
    return largest, last

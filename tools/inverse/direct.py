"""Direct mapping as rows: each projector pixel asks the one camera pixel that it lights most (thesis 6.1)."""

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.maps.row_map import SparseRows
from counterlight.tools.transport.objective import FAINTEST
from counterlight.tools.transport.transport import luminance


def direct_mapping(dual: SparseRows, composition: FloatArray, heard: FloatArray) -> SparseRows:
    """p_j = b_i / (T·1)_i at the camera pixel i that projector pixel j lights most.

    dual : near TᵀW, (projector pixels, camera pixels).  composition : T·1, (camera pixels, 3).  heard : (projector
    pixels, 3), what is left of it beside the prior.
    """
    rows = dual.rows
    strength = luminance(dual.weights)
    brightest = np.zeros(dual.shape[0])
    np.maximum.at(brightest, rows, strength)
    last = np.full(dual.shape[0], -1)
    candidates = np.flatnonzero(strength == brightest[rows])
    np.maximum.at(last, rows[candidates], candidates)
    strongest = last[last >= 0]
    chosen = dual.indices[strongest]
    light = composition[chosen]
    inverse = np.divide(1.0, light, out=np.zeros_like(light), where=light > FAINTEST * composition.max(initial=0.0))
    inverse = inverse * heard[rows[strongest]]
    starts = np.searchsorted(rows[strongest], np.arange(dual.indptr.size))
    return SparseRows(starts, chosen, inverse, dual.columns)

"""Direct mapping: each projector pixel asks one camera pixel (thesis 6.1; SmartProjector, Bimber et al. 2005)."""

import numpy as np

from counterlight.tools.solve.solution import Solution
from counterlight.tools.solve.system import LinearSystem


def solve_direct(system: LinearSystem) -> Solution:
    """p_j = b_i / (T·1)_i at the camera pixel i that projector pixel j lights most; 0 where it lights none."""
    rows = np.repeat(np.arange(system.shape[0]), np.diff(system.near.indptr))
    columns, values = system.near.indices, system.near.data
    order = np.lexsort((values, columns))
    last = np.append(np.diff(columns[order]) != 0, True)[: order.size]
    strongest = order[last]
    flood = system.apply(np.ones(system.shape[1]))
    drive = np.zeros(system.shape[1])
    drive[columns[strongest]] = system.target[rows[strongest]] / flood[rows[strongest]]
    return Solution(drive)

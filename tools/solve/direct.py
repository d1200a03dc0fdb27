"""Direct mapping: each projector pixel asks one camera pixel (thesis 6.1; SmartProjector, Bimber et al. 2005)."""

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.tools.inverse.direct import direct_mapping
from counterlight.tools.solve.solution import Solution
from counterlight.tools.transport.transport import CHANNELS, Transport


class Direct:
    """p_j = b_i / (T·1)_i at the camera pixel i that projector pixel j lights most; 0 where it lights none."""

    def __init__(self, T: Transport) -> None:
        alike = np.ones((T.shape[1], len(CHANNELS)))
        self._rows = direct_mapping(T.T, T.composition(), alike)

    def solve(self, b: FloatArray) -> Solution:
        return Solution(self._rows.apply(b))

"""Direct mapping: each projector pixel asks one camera pixel (thesis 6.1; SmartProjector, Bimber et al. 2005)."""

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.tools.inverse.direct import lit_most
from counterlight.tools.solve.channel import Channel


class Direct:
    """p_j = b_i / (T·1)_i at the camera pixel i that projector pixel j lights most; 0 where it lights none."""

    def __init__(self, T: Channel) -> None:
        most = lit_most(T.alone().T)
        self._asking, self._pixels = np.flatnonzero(most >= 0), T.shape[1]
        self._asked = most[self._asking]
        self._light = T.operator.matvec(np.ones(T.shape[1]))[self._asked]

    def solve(self, b: FloatArray) -> tuple[FloatArray, tuple[str, ...]]:
        drive = np.zeros(self._pixels)
        drive[self._asking] = b[self._asked] / self._light
        return drive, ()

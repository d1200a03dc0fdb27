"""Direct mapping: each projector pixel asks one camera pixel, or three (thesis 6.1; SmartProjector, 2005)."""

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.tools.inverse.direct import direct_mapping
from counterlight.tools.inverse.triangulated import triangulated_mapping
from counterlight.tools.solve.solution import Solution
from counterlight.tools.transport.transport import CHANNELS, Transport


class Direct:
    """p_j = b_i / (T·1)_i at the camera pixel i that projector pixel j lights most; 0 where it lights none."""

    def __init__(self, T: Transport) -> None:
        alike = np.ones((T.shape[1], len(CHANNELS)))
        self._rows = direct_mapping(T.T, T.composition(), alike)

    def solve(self, b: FloatArray) -> Solution:
        return Solution(self._rows.apply(b))


class Triangulated:
    """Direct mapping to a fraction of a pixel, between three neighbouring camera pixels; see triangulated.py.

    As the player does, it asks for no more light than each camera pixel can have: 0 to T·1.
    """

    def __init__(self, T: Transport) -> None:
        """ValueError if T does not know how high and wide its pictures are."""
        if T.camera is None or T.projector is None:
            raise ValueError("T does not know the sizes of camera and projector, expected (height, width) of both")
        self._rows, self._most = triangulated_mapping(T, T.camera, T.projector), T.composition()

    def solve(self, b: FloatArray) -> Solution:
        return Solution(self._rows.apply(np.clip(b, 0, self._most)))

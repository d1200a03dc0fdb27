"""Direct mapping: each projector pixel uses one camera pixel, or three (thesis 6.1; SmartProjector, 2005)."""

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.tools.inverse.direct import direct_mapping, triangulated_mapping
from counterlight.tools.solve.solution import Solution
from counterlight.tools.transport.transport import CHANNELS, Transport


class Direct:
    """p_j = b_i / (T·1)_i at the camera pixel i that projector pixel j lights most; 0 if it lights none."""

    def __init__(self, T: Transport) -> None:
        alike = np.ones((T.shape[1], len(CHANNELS)))
        self._rows = direct_mapping(T.T, T.composition(), alike)

    def solve(self, b: FloatArray) -> Solution:
        return Solution(self._rows.apply(b))


class Triangulated:
    """Direct mapping with sub-pixel precision, between three neighbouring camera pixels; see tools/inverse/direct.py.

    As in the player, the target is limited to 0..T·1, what each camera pixel can have.
    """

    def __init__(self, T: Transport) -> None:
        """Prepare T; raises ValueError if T does not know its pictures' sizes."""
        if T.camera is None or T.projector is None:
            raise ValueError("T does not know the sizes of camera and projector, expected (height, width) of both")
        self._rows, self._most = triangulated_mapping(T, T.camera, T.projector), T.composition()

    def solve(self, b: FloatArray) -> Solution:
        return Solution(self._rows.apply(np.clip(b, 0, self._most)))

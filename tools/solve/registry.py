"""The solvers by name: `prepare(name, T)` does the work that no picture changes, and `solve(b)` the rest."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray
from counterlight.tools.clusters.components import refuse_not_finite
from counterlight.tools.solve.box import Box
from counterlight.tools.solve.channel import Channel
from counterlight.tools.solve.direct import Direct, Triangulated
from counterlight.tools.solve.nnls import nnls
from counterlight.tools.solve.qr import qr
from counterlight.tools.solve.solution import ChannelSolver, Solution, Solver
from counterlight.tools.solve.svd import svd
from counterlight.tools.transport.objective import Objective
from counterlight.tools.transport.transport import CHANNELS, Transport


class ChannelByChannel:
    """A solver of one channel at a time; notes are prefixed with the channel's name."""

    def __init__(self, T: Transport, prepare: Callable[[Channel], ChannelSolver]) -> None:
        self._solvers = [prepare(Channel.of(T, i)) for i in range(len(CHANNELS))]

    def solve(self, b: FloatArray) -> Solution:
        found = [solver.solve(b[:, i]) for i, solver in enumerate(self._solvers)]
        notes = tuple(f"{name}: {note}" for name, (_, said) in zip(CHANNELS, found, strict=True) for note in said)
        return Solution(np.stack([p for p, _ in found], axis=1), notes)


SOLVERS: dict[str, Callable[[Transport], Solver]] = {
    "direct": Direct,
    "qr": lambda T: ChannelByChannel(T, qr),
    "svd": lambda T: ChannelByChannel(T, svd),
    "nnls": lambda T: ChannelByChannel(T, nnls),
    "box": Box,
}
# T must know its pictures' sizes
OF_PICTURES: dict[str, Callable[[Transport], Solver]] = {"triangulated": Triangulated}


class Prepared:
    """A solver for one T and mask, or the box for an objective; see `prepare`."""

    def __init__(self, name: str, T: Transport, mask: NDArray[np.bool_] | None, objective: Objective | None) -> None:
        weighed = objective if name == "box" else None
        self.T, self._mask = T if mask is None else T.inside(mask), mask if weighed is None else None
        refuse_not_finite(self.T.near, np.zeros((1, len(CHANNELS))))
        self._solver = (SOLVERS | OF_PICTURES)[name](self.T) if weighed is None else Box(weighed)

    def solve(self, b: NDArray[np.floating]) -> Solution:
        """Solve min ‖T p − b‖² over the camera pixels that count.

        b : c − e, (camera pixels, 3) or (camera height, camera width, 3).

        Raises NonFiniteError.
        """
        b = np.array(b, np.float64).reshape(-1, len(CHANNELS))
        if b.shape[0] != self.T.shape[0]:
            raise ValueError(f"b has {b.shape[0]} camera pixels, T has {self.T.shape[0]}")
        if self._mask is not None:
            b[~self._mask.ravel()] = 0
        refuse_not_finite(self.T.near, b)
        return self._solver.solve(b)


def prepare(
    name: str, T: Transport, mask: NDArray[np.bool_] | None = None, objective: Objective | None = None
) -> Prepared:
    """Factorise one T for one of SOLVERS or OF_PICTURES; raises KeyError for another name.

    mask : (camera height, camera width) or (camera pixels,). Camera pixels that count; None for all.
    objective : what the box minimises, as the player does; None for ½‖T p − b‖², as the others do.

    Raises NonFiniteError, with the cluster, if T is not finite in float32.
    """
    return Prepared(name, T, mask, objective)

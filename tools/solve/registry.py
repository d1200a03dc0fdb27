"""The solvers by name."""

from collections.abc import Callable, Sequence

from counterlight.tools.solve.box import solve_box
from counterlight.tools.solve.direct import solve_direct
from counterlight.tools.solve.nnls import solve_nnls
from counterlight.tools.solve.qr import solve_qr
from counterlight.tools.solve.solution import Solution
from counterlight.tools.solve.svd import solve_svd
from counterlight.tools.solve.system import LinearSystem

Solver = Callable[[Sequence[LinearSystem]], list[Solution]]


def one_by_one(solver: Callable[[LinearSystem], Solution]) -> Solver:
    return lambda systems: [solver(system) for system in systems]


SOLVERS: dict[str, Solver] = {
    "direct": one_by_one(solve_direct),
    "qr": one_by_one(solve_qr),
    "svd": one_by_one(solve_svd),
    "nnls": one_by_one(solve_nnls),
    "box": solve_box,
}


def solve(name: str, system: LinearSystem) -> Solution:
    """One of SOLVERS on one colour channel; KeyError for another name."""
    return SOLVERS[name]([system])[0]


def solve_channels(name: str, systems: Sequence[LinearSystem]) -> list[Solution]:
    """One of SOLVERS on up to three colour channels of one shape."""
    return SOLVERS[name](systems)

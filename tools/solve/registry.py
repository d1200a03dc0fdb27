"""The solvers by name."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

from threadpoolctl import threadpool_limits

from tools.solve.box import solve_box
from tools.solve.direct import solve_direct
from tools.solve.nnls import solve_nnls
from tools.solve.qr import solve_qr
from tools.solve.solution import Solution
from tools.solve.svd import solve_svd
from tools.solve.system import LinearSystem

SOLVERS: dict[str, Callable[[LinearSystem], Solution]] = {
    "direct": solve_direct,
    "qr": solve_qr,
    "svd": solve_svd,
    "nnls": solve_nnls,
    "box": solve_box,
}


ONE_CORE = ("direct", "box")  # the others use all cores for each channel


def solve(name: str, system: LinearSystem) -> Solution:
    """One of SOLVERS on one colour channel; KeyError for another name."""
    return SOLVERS[name](system)


def solve_channels(name: str, systems: Sequence[LinearSystem]) -> list[Solution]:
    """One of SOLVERS on several colour channels."""
    if name not in ONE_CORE:
        return [solve(name, system) for system in systems]
    with threadpool_limits(limits=1), ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(SOLVERS[name], systems))

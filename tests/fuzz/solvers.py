"""Random sparse systems for the CPU solvers, judged by scipy and by each other: the properties in test_solve.py."""

from collections.abc import Callable
from functools import partial
from typing import Any

from counterlight.errors import one_line
from tests import test_solve
from tests.fuzz.tally import READ, WRONG, Plan, Tally, Trial


def without_draws(test: Any) -> Callable[..., None]:
    """Return the test of a property as a function of its seed."""
    inner: Callable[..., None] = test.hypothesis.inner_test
    return inner


MINIMUM_NORM = without_draws(test_solve.test_least_squares_is_of_minimum_norm)
PROPERTIES: tuple[Callable[..., None], ...] = (
    without_draws(test_solve.test_box_is_never_worse_than_any_clamped_solution),
    without_draws(test_solve.test_box_is_scipys_bounded_optimum),
    without_draws(test_solve.test_the_certificate_bounds_the_distance_of_any_drive),
    without_draws(test_solve.test_nnls_is_scipys),
    partial(MINIMUM_NORM, solver="qr"),
    partial(MINIMUM_NORM, solver="svd"),
)


class Solvers:
    """Every trial draws a system and checks one property of the solvers."""

    name, count = "solvers", 600
    purpose = "CPU solvers: random systems, against scipy's solution"

    def run(self, plan: Plan) -> Tally:
        tally = Tally(self.name, plan)
        for index in plan.indices():
            seed = int(plan.rng(self.name, index).integers(2**32))
            try:
                PROPERTIES[index % len(PROPERTIES)](seed=seed)
                tally.add(index, Trial(READ))
            except AssertionError as error:
                tally.add(index, Trial(WRONG, f"seed {seed}: {one_line(error)}"))
        return tally

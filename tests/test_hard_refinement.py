"""Refinement, the player's default, on hard cases: built and played as a user does, and measured with the true T.

No method within 0..1 beats the box optimum of the plain least squares with equal weights per camera pixel. Refinement
may lose to it only through the prior, which keeps noise and drift from spoiling poorly measured parts of T
(docs/mathematics.md).
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from tests import hard_systems as hard
from tests.hard_systems import HardCase
from tests.studies import hard_cases

UNFINISHED = 1e-4  # the largest measured value is 7e-5, with condition 1e14
PRIOR = 0.006  # share of the floodlit room's RMS; the largest measured value is 0.0052
MOST_NOISE = {
    "weights 1e-7 to 1e3": 300,  # noise of the brightest pixels drives the faintest pixel over its full range
    "rank-deficient, wide": 20,  # pixels that the camera cannot separate have weak ties
}
CASES = {
    case.name: case
    for case in (
        *(hard.defocused_wall(condition) for condition in (1e2, 1e4, 1e8, 1e14)),
        hard.capture_noise(0.05),
        hard.noise_floor(),
        hard.misaligned(1.0),
        hard.far_light(1.0),
        hard.far_light(10.0),
        hard.two_projectors(0.1),
        hard.conflicting_rows(),
        hard.rank_deficient((9, 15)),
        hard.graded_weights(),
        hard.rescaled(hard.defocused_wall(1e4), 1e-6),
        *(case for case in hard.targets() if case.name.split()[-1] in ("random", "above", "pixel")),
    )
}


@pytest.mark.parametrize("name", CASES)
def test_steps_never_make_a_hard_case_worse_and_come_close_to_the_optimum(name: str) -> None:
    refined = hard.refining(CASES[name])
    drives = {steps: refined(steps)(CASES[name].target) for steps in (0, 4, 64)}
    case = possible(CASES[name])
    assert all(np.isfinite(p).all() and 0 <= p.min() <= p.max() <= 1 for p in drives.values())
    first, few, many = (case.error(p) for p in drives.values())
    wrong = known_wrong(case)
    least = optimum(case) + PRIOR
    assert few <= max(first, least) * 1.01 + wrong
    assert many <= max(few, least) * 1.01 + wrong
    assert many <= least + wrong
    noise = hard_cases.amplification(CASES[name], refined(64), drives[64])
    assert noise <= MOST_NOISE.get(name, 12)  # a plain inverse: up to the condition number


def possible(case: HardCase) -> HardCase:
    return replace(case, target=np.clip(case.target, 0, case.floodlight))


def optimum(case: HardCase) -> float:
    """Error of scipy's bounded least squares, less what its iterations may have left."""
    unit = np.linalg.norm(case.floodlight)  # scipy's tolerance is absolute
    return case.error(lsq_linear(case.dense / unit, case.target / unit, (0, 1), tol=1e-10).x) - UNFINISHED


def known_wrong(case: HardCase) -> float:
    """RMS error of T against the true transport; by this much, steps may come nearer to the target than the optimum."""
    if case.truth is None:
        return 0.0
    p = hard.rng(15).uniform(size=case.T.shape[1])
    return float(np.linalg.norm((case.T - case.truth) @ p) / np.linalg.norm(case.floodlight))

"""Changes of the wall that stay are learned from comparisons of changing pictures; noise, people and lamps are not."""

from collections.abc import Callable

import numpy as np
import pytest

from counterlight.tools.watching.learning import PART_S, PARTS, Learning
from tests.rig.rays import FloatArray

SHAPE, EVERY_S = (12, 15), 1.0
NOISE, OFFSET = 0.02, 0.01  # shares of the light, and of white
SEVERAL_S = (PARTS + 1.5) * PART_S
NEAR = 0.01  # 200 comparisons with 2 % of noise leave 0.002
ROWS, COLUMNS = np.mgrid[: SHAPE[0], : SHAPE[1]]
SPOT = (ROWS - 5) ** 2 + (COLUMNS - 8) ** 2 < 9
Factors = Callable[[float], FloatArray]


def everywhere(factors: FloatArray | float) -> FloatArray:
    return np.broadcast_to(factors, (*SHAPE, 3)).astype(np.float64)


def spot(*factors: float) -> FloatArray:
    return np.where(SPOT[..., None], factors, 1.0)


def learned(
    gains: Factors, seconds: float, *, contrast: float = 1.0, learning: Learning | None = None, begin_s: float = 0.0
) -> Learning:
    """Return what is learned from a film of random blocks.

    gains : true factors at a time, (*SHAPE, 3).
    contrast : of the film; 0 never changes.
    """
    rng = np.random.default_rng(2)
    made = learning or Learning(SHAPE, np.ones(SHAPE[0] * SHAPE[1], np.bool_))
    for time_s in np.arange(begin_s, begin_s + seconds, EVERY_S):
        x = 0.5 + contrast * rng.uniform(-0.4, 0.4, (SHAPE[0] * SHAPE[1], 3))
        c = gains(float(time_s)).reshape(x.shape) * x * (1 + NOISE * rng.normal(size=x.shape)) + OFFSET
        made.add(float(time_s), x, c, 1 / (NOISE * x) ** 2)
    return made


@pytest.mark.parametrize("factors", [(0.8, 0.8, 0.8), (0.6, 1.0, 1.0), (1.1, 1.1, 0.9)])
def test_a_spot_that_stays_is_learned_and_only_the_spot(factors: tuple[float, float, float]) -> None:
    made = learned(lambda _: spot(*factors), SEVERAL_S)
    expected = spot(*factors).reshape(-1, 3)
    np.testing.assert_allclose(made.learned.gains, expected, atol=NEAR)
    assert np.all(made.learned.gains[~SPOT.ravel()] == 1)


def test_a_spot_that_is_cleaned_is_forgotten() -> None:
    made = learned(lambda _: spot(0.8, 0.8, 0.8), SEVERAL_S)
    made = learned(lambda _: everywhere(1.0), SEVERAL_S, learning=made, begin_s=SEVERAL_S)
    assert np.all(made.learned.gains == 1)


@pytest.mark.parametrize(
    "gains",
    [
        lambda _: everywhere(1.0),
        lambda _: everywhere(np.array([0.9, 1.0, 0.8])),  # a lamp, which is not the learner's matter
        lambda time_s: spot(*3 * [0.3 if 100 < time_s < 160 else 1.0]),  # a person who stands still for a minute
        lambda time_s: spot(*3 * [0.3 if time_s % 30 < 15 else 1.0]),  # people who come and go
        lambda _: np.where((COLUMNS == 7)[..., None], 0.8, everywhere(1.0)),  # an edge that the camera sees elsewhere
    ],
    ids=["nothing", "lamp", "person", "people", "edge"],
)
def test_what_does_not_stay_is_not_learned(gains: Factors) -> None:
    made = learned(gains, 2 * SEVERAL_S)
    assert np.all(made.learned.gains == 1)


def test_a_film_that_never_changes_teaches_nothing() -> None:
    assert np.all(learned(lambda _: spot(0.8, 0.8, 0.8), SEVERAL_S, contrast=0.0).learned.gains == 1)


def test_a_change_beyond_the_limits_is_left_alone_and_counted() -> None:
    made = learned(lambda _: spot(0.3, 0.3, 0.3), SEVERAL_S)
    assert np.all(made.learned.gains == 1)
    assert made.learned.beyond == SPOT.mean()


def test_g_must_predict_the_comparisons_that_are_held_back() -> None:
    """Every third comparison sees another wall."""
    count = iter(range(1, 10**6))
    made = learned(lambda _: spot(*3 * [1.2 if next(count) % 3 == 0 else 0.9]), SEVERAL_S)
    assert np.all(made.learned.gains == 1)

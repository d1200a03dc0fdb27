"""Steps per frame: a machine of known speed and a room of known errors, for every budget and promise."""

from statistics import median

import pytest

from counterlight.pipeline.refinement import MOST_STEPS, Curve, Offer
from counterlight.pipeline.shortfall import Shortfall
from counterlight.show.governor import TRIES, WELL_WITHIN, Governor

FRAME_S = 0.04
SELDOM = 5  # frames of 200 that may try one more step: after 8, 16, 32, 64, 100 frames
STARTS = {"map": "previous", "direct": "previous-direct"}
CURVE = Curve((0, 2, 4, 8, 16), (6.0, 1.6, 0.6, 0.2, 0.06))


class Machine:
    """Fake machine that draws frames.

    base_s : seconds per frame without start and steps.
    step_s : seconds per step.
    start_s : seconds per start, by name.
    """

    def __init__(self, governor: Governor, base_s: float, step_s: float, **start_s: float) -> None:
        self.governor, self.base_s, self.step_s, self.start_s = governor, base_s, step_s, start_s
        self.said: list[str] = []
        governor.notice = self.said.append
        self.times: list[float] = []
        self.steps: list[int] = []

    def draw(self, frames: int, below: Curve | None = None) -> None:
        """Draw frames.

        below : dB below the optimum by steps, estimated for every frame.
        """
        for _ in range(frames):
            governor, steps = self.governor, self.governor.steps
            start = governor.start if steps else STARTS[governor.bare]
            start_s = self.start_s.get(start.replace("-", "_"), 0.0)
            stages = {"linear": self.base_s, "start": start_s} | ({"steps": steps * self.step_s} if steps else {})
            self.times.append(sum(stages.values()))
            self.steps.append(steps)
            governor.took(self.times[-1], steps, stages)
            if below is not None:
                governor.judged(Shortfall(below.at(steps), below.at(steps) - below.at(2 * steps), steps, 4, 4))


@pytest.mark.parametrize(("base_s", "step_s"), [(0.002, 0.0001), (0.005, 0.001), (0.001, 0.006), (0.011, 0.0004)])
@pytest.mark.parametrize("interval_s", [FRAME_S, None], ids=["film", "still"])
def test_a_budget_is_met_and_used_on_any_machine(base_s: float, step_s: float, interval_s: float | None) -> None:
    governor = Governor(4, budget=16)
    governor.begin(interval_s)
    machine = Machine(governor, base_s, step_s)
    machine.draw(200)
    assert max(machine.times[1:]) <= 0.016
    assert machine.times[-1] > 0.75 * 0.016 - step_s or machine.steps[-1] == MOST_STEPS
    assert not machine.said
    assert governor.refine == "auto"


def test_a_first_frame_that_takes_long_costs_no_steps() -> None:
    governor = Governor(4, budget=16)
    governor.begin(FRAME_S)
    machine = Machine(governor, 0.08, 0.03)
    machine.draw(1)
    machine.base_s, machine.step_s = 0.004, 0.001
    machine.draw(3)
    assert machine.steps[-1] == 8
    assert not machine.said


def test_the_next_medium_begins_with_the_steps_that_fitted_last() -> None:
    governor = Governor(16)
    governor.begin(FRAME_S)
    machine = Machine(governor, 0.004, 0.004)
    machine.draw(20)
    governor.begin(FRAME_S)
    machine.draw(1)
    assert machine.times[-1] <= FRAME_S
    assert machine.steps[-1] == 7
    governor.begin(2 * FRAME_S)  # another frame rate
    assert governor.steps == 16


def test_other_work_that_comes_and_goes_costs_few_frames_their_steps() -> None:
    """One frame in twenty takes twenty times as long; a permanently slower period follows, and ends."""
    governor = Governor(4, budget=16)
    governor.begin(FRAME_S)
    machine = Machine(governor, 0.004, 0.001)
    machine.draw(3)
    for number in range(200):
        machine.base_s, machine.step_s = (0.08, 0.02) if number % 20 == 0 else (0.004, 0.001)
        machine.draw(1)
    assert median(machine.steps[3:]) == 8
    machine.base_s, machine.step_s = 0.008, 0.02
    machine.draw(100)
    assert median(machine.steps[-50:]) == 0
    machine.base_s, machine.step_s = 0.004, 0.001
    machine.draw(130)
    assert machine.steps[-1] >= 7


def test_a_budget_that_cannot_be_met_is_reported_once_with_the_longest_stage() -> None:
    governor = Governor(8, budget=16)
    governor.begin(FRAME_S)
    machine = Machine(governor, 0.012, 0.003, previous=0.015)
    machine.draw(200)
    assert machine.steps[-1] == 0
    [line] = machine.said
    assert line.startswith("--budget 16 cannot be kept: with 0 steps a frame takes 27 ms (linear 12.0, start 15.0); ")
    assert "build a smaller correction map (counterlight build --inverse none), or" in line
    governor.begin(FRAME_S)  # another medium begins
    machine.draw(TRIES + 1)  # the first with a step
    assert len(machine.said) == 2


def test_a_budget_without_time_for_a_step_shows_the_maps_picture_if_that_is_the_faster_one() -> None:
    for quick in (True, False):
        governor = Governor(4, budget=60, start="previous-direct", quick=quick)
        governor.begin(FRAME_S)
        machine = Machine(governor, 0.025, 0.053)
        machine.draw(200)
        least = int(not quick)
        assert machine.steps[2] == machine.steps[-1] == least
        assert sum(steps > least for steps in machine.steps[2:]) <= SELDOM
        assert len(machine.said) == int(not quick)


@pytest.mark.parametrize(("map_in_steps", "bare"), [(0.5, "map"), (5.0, "direct")])
def test_a_budget_without_time_for_the_maps_picture_either_shows_direct_mapping(map_in_steps: float, bare: str) -> None:
    offers = Offer("previous", map_in_steps, CURVE), Offer("previous-direct", 0.1, CURVE)
    governor = Governor(4, budget=16, start="previous-direct", offers=offers, quick=map_in_steps < 1)
    governor.begin(FRAME_S)
    machine = Machine(governor, 0.008, 0.006, previous=map_in_steps * 0.006, previous_direct=0.0006)
    machine.draw(200)
    assert (governor.bare, machine.steps[2], machine.steps[-1]) == (bare, 0, 0)
    assert sum(machine.steps[2:]) <= SELDOM
    assert max(machine.times[2:]) <= 0.016
    assert not machine.said
    governor.set_budget("no")
    assert governor.bare == "map"


def test_steps_are_not_fewer_than_a_clean_picture_needs() -> None:
    """Three steps end within a decibel of the optimum, two do not. Without a curve, the least number is unknown."""
    for offers, least in (((Offer("previous", 0.5, CURVE),), 3), ((), 0)):
        governor = Governor(8, start="previous", offers=offers)
        governor.begin(FRAME_S)
        machine = Machine(governor, 0.005, 0.02)
        machine.draw(50)
        assert min(machine.steps) == min(machine.steps[-5:]) == max(least, 1)
        assert governor.is_at_least == bool(offers)
        governor.slow_to(3 * FRAME_S)
        machine.draw(200)
        assert machine.steps[-1] == 4  # 4 steps take 85 ms of the allowed 120 ms


@pytest.mark.parametrize(("budget", "start"), [(16.0, "previous-direct"), (60.0, "previous")])
def test_the_start_is_the_one_that_is_nearer_within_the_budget(budget: float, start: str) -> None:
    """T⁺ b takes as long as ten steps and is worth eight, so it pays only with a long budget."""
    better = Curve((0, 2, 4, 8, 16), (1.0, 0.4, 0.1, 0.01, 0.001))
    offers = Offer("previous", 10.0, better), Offer("previous-direct", 0.1, CURVE)
    governor = Governor(4, budget=budget, start="previous", offers=offers)
    governor.begin(FRAME_S)
    machine = Machine(governor, 0.002, 0.001, previous=0.01, previous_direct=0.0001)
    machine.draw(50)
    assert governor.start == start
    assert max(machine.times[2:]) <= budget / 1000


@pytest.mark.parametrize("within", [1.0, 0.1, 0.02])
@pytest.mark.parametrize("interval_s", [FRAME_S, None], ids=["film", "still"])
def test_a_promise_is_kept_with_few_steps(within: float, interval_s: float | None) -> None:
    governor = Governor(4, within=within)
    governor.begin(interval_s)
    machine = Machine(governor, 0.001, 0.0001)
    machine.draw(60, CURVE)
    assert all(CURVE.at(steps) <= within for steps in machine.steps[8:])
    least = CURVE.least(within)
    assert least <= machine.steps[-1] <= 3 * least + 1
    assert CURVE.at(machine.steps[-1]) > WELL_WITHIN * within / 3
    assert not machine.said


def test_a_promise_that_time_does_not_leave_is_reported_once() -> None:
    governor = Governor(4, budget=16, within=0.1)
    governor.begin(FRAME_S)
    machine = Machine(governor, 0.004, 0.001)
    machine.draw(100, CURVE)
    assert max(machine.times[1:]) <= 0.016
    [line] = machine.said
    assert line.startswith("--within 0.1 cannot be kept: at most 8 steps in 16 ms a frame, and 8 end 0.2 dB below the")
    assert "as many again would bring 0.14" in line


def test_a_promise_that_no_number_of_steps_keeps_is_reported_once() -> None:
    governor = Governor(4, within=0.1)
    governor.begin(None)
    machine = Machine(governor, 0.0, 1e-4)
    machine.draw(60, Curve((0, 1), (2.0, 2.0)))
    assert machine.steps[-1] == MOST_STEPS
    assert len(machine.said) == 1


def test_steps_that_were_too_few_are_not_tried_again() -> None:
    governor = Governor(4, within=0.5)
    governor.begin(None)
    machine = Machine(governor, 0.0, 1e-4)
    machine.draw(1, Curve((0, 1), (0.6, 0.6)))
    machine.draw(50, Curve((0, 1), (0.001, 0.001)))
    assert machine.steps[-1] == 5


def test_a_number_of_steps_ends_budget_and_promise_and_they_end_it() -> None:
    governor = Governor(6, refine=3)
    governor.begin(FRAME_S)
    assert governor.steps == 3
    governor.set_within(0.1)
    assert (governor.refine, governor.within, governor.governs) == ("auto", 0.1, True)
    governor.set_budget(5.0)
    governor.set_refine(7)
    assert (governor.budget, governor.within, governor.steps) == ("no", "no", 7)
    governor.set_budget(5.0)
    governor.set_budget("no")
    assert (governor.refine, governor.governs, governor.steps) == (6, False, 6)


def test_a_curve_goes_through_what_was_measured_and_falls_on() -> None:
    assert [CURVE.at(steps) for steps in CURVE.steps] == pytest.approx(CURVE.decibels)
    assert 0.2 < CURVE.at(6) < 0.6
    assert CURVE.at(64) < CURVE.at(32) < 0.06
    assert CURVE.least(0.2) == 8
    flat = Curve((0, 2), (1.0, 1.0))
    assert flat.at(100) == 1
    assert flat.least(0.5) == MOST_STEPS

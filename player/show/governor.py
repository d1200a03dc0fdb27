"""Chooses the start and the number of steps of each frame by options, time and estimates; draws the frame with them."""

import math
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from statistics import median
from typing import Literal, TypeAlias

from counterlight.command import tell
from counterlight.pipeline.refinement import GOOD_ENOUGH_DB, MOST_OFFERED, MOST_STEPS, Offer, StepBudget
from counterlight.pipeline.renderer import AnyRenderer
from counterlight.pipeline.shortfall import Shortfall
from counterlight.show.stats import Stats

Steps: TypeAlias = int | Literal["auto"]
Limit: TypeAlias = float | Literal["no"]
WELL_WITHIN = 1 / 3  # share of the allowed decibels; at a smaller distance, fewer steps are tried
# factors for one change of the steps: smallest and largest factor of a decrease, largest factor of an increase
FEWEST, FEWER, MORE = 1 / 2, 3 / 4, 4.0
FALL = 0.6  # dB below the optimum are roughly proportional to steps^-1.7
RECENT, TELLING = 7, 3  # RECENT: frames in a median of times; TELLING: frames that are needed to choose a start
TRIES = 5  # failures in a row that cause a notice


class Governor:
    """Chooses steps and start for one show. The caller reports each drawn frame and each estimate to it.

    usual : steps that the room needs.
    refine : steps, "auto", or None for the usual steps, fewer if frames would be late.
    budget : milliseconds that drawing a frame may take.
    within : allowed dB below the optimum, called the promise.
    start : the start of refinement.
    offers : starts to choose from if the user gives no number of steps.
    quick : whether the correction map takes less time than direct mapping with one step. A budget may then allow 0
        steps.

    bare : picture of a frame without a step: "map", or "direct" if the correction map does not fit into a budget.
    step_s : seconds per step, None until a step was timed.
    notice : takes a line for the user, at most once per medium.
    looks : number of consecutive estimates that must miss the promise before a notice.
    """

    def __init__(
        self,
        usual: int,
        refine: Steps | None = None,
        *,
        budget: Limit = "no",
        within: Limit = "no",
        start: str = "previous",
        offers: Sequence[Offer] = (),
        quick: bool = True,
    ) -> None:
        self.refine: Steps = usual if refine is None else refine
        self.budget, self.within, self.start = budget, within, start
        self.step_s: float | None = None
        self.notice: Callable[[str], None] = tell
        self.looks = TRIES
        self._usual, self._hurries, self._offers = usual, refine is None, offers
        self._quick = quick
        self._interval_s: float | None = None
        self._cold = True
        self._time: StepBudget | None = None
        self._rests_s, self._each_s = (deque[float](maxlen=RECENT) for _ in range(2))
        self._wish = self._failed = 0
        self._adopt()

    def begin(self, interval_s: float | None) -> None:
        """Start another medium. At the same frame rate, it begins with the steps that fitted last.

        interval_s : seconds from one frame to the next; None for a still.
        """
        before, self._interval_s = self._time, interval_s
        self._begin()
        if before is not None and self._time is not None:
            self._time.follow(before)

    def slow_to(self, interval_s: float) -> None:
        """Set another frame interval for the same medium."""
        self._interval_s = interval_s
        if self._time is not None and self._limit_s is not None:
            self._time.interval_s = self._limit_s

    def set_refine(self, steps: Steps) -> None:
        """Use a fixed number of steps, or as many as fit. Cancels the budget and the promise."""
        self.refine, self._hurries, self.budget, self.within = steps, False, "no", "no"
        self._begin()

    def set_budget(self, milliseconds: Limit) -> None:
        self.budget = milliseconds
        self._adopt(self._usual)

    def set_within(self, decibels: Limit) -> None:
        self.within = decibels
        self._adopt(self._usual)

    @property
    def steps(self) -> int:
        """Steps of the next frame."""
        if self._time is None:
            return self._wish
        return max(min(self._time.steps, self._wish), self._least if self.governs else 0)

    @property
    def adapts(self) -> bool:
        """Whether the time of a frame limits its steps."""
        return self._time is not None

    @property
    def is_at_least(self) -> bool:
        """Whether a frame has the fewest possible steps."""
        return self._time is None or self.steps <= self._time.least

    def took_ms(self, steps: int) -> float | None:
        """Return the milliseconds that `steps` steps take, None until a step was timed."""
        return None if self.step_s is None else 1000 * steps * self.step_s

    @property
    def governs(self) -> bool:
        """Whether a budget or a promise applies."""
        return self.budget != "no" or self.within != "no"

    def took(self, seconds: float, steps: int, stage_s: Mapping[str, float]) -> None:
        """Record the time that drawing a frame took.

        A first frame that takes too long is ignored, because it loads data that later frames find in memory.

        seconds : time of the whole frame.
        steps : number of steps in the frame.
        stage_s : seconds per stage (pipeline/stage_times.py), empty if the stages were not timed.
        """
        cold, self._cold = self._cold, False
        if cold and self._time is not None and not self._time.fits(seconds):
            return
        if self._time is not None and steps == self.steps:
            self._time.took(seconds)
        if stage_s:
            self._measured(seconds, steps, stage_s)
        self._check_budget(seconds, steps, stage_s)

    def _measured(self, seconds: float, steps: int, stage_s: Mapping[str, float]) -> None:
        """Update the medians of the last frames. A median ignores a single frame that other processes delayed."""
        start_s, steps_s = stage_s.get("start", 0.0), stage_s.get("steps", 0.0)
        self._rests_s.append(seconds - start_s - steps_s)
        if steps:
            self._each_s.append(steps_s / steps)
        if not self._each_s:
            return
        rest_s, self.step_s = median(self._rests_s), median(self._each_s)
        if len(self._each_s) >= TELLING:
            self._choose(rest_s, start_s, self.step_s)
        self.bare = self._bare_start(rest_s, self.step_s)
        if self._time is not None and steps:
            self._time.measured(rest_s + start_s, self.step_s)

    def judged(self, found: Shortfall) -> None:
        """Adapt the steps to an estimate of a drawn picture."""
        if self.within == "no":
            return
        ratio, made = found.decibels / self.within, found.steps
        if ratio > 1:
            self._failed = max(self._failed, made)
            self._want(min(max(round(made * min(ratio**FALL, MORE)), made + 1), MOST_STEPS))
            self._check_promise(found)
        else:
            self._misses = 0
            if ratio < WELL_WITHIN:
                fewer = int(made * min(max(ratio**FALL, FEWEST), FEWER))
                self._want(max(min(fewer, self._wish), self._failed + 1, self._least))

    @property
    def _least(self) -> int:
        """The fewest steps: 0 from T⁺ b, and 1 from other starts unless a budget leaves no time for a step."""
        if self.budget != "no" and (self._quick or self.bare == "direct"):
            return 0
        return int(self.start not in ("previous", "map"))

    @property
    def _limit_s(self) -> float | None:
        """Seconds that a frame may take."""
        return self._interval_s if self.budget == "no" else self.budget / 1000

    def _adopt(self, otherwise: Steps | None = None) -> None:
        """Apply the budget and the promise, which override a number of steps.

        otherwise : steps if neither applies any more.
        """
        if self.governs:
            self.refine, self._hurries = "auto", False
        elif otherwise is not None:
            self.refine, self._hurries = otherwise, True
        self._begin()

    def _begin(self) -> None:
        self._failed, self._misses, self._late, self._said = 0, 0, 0, False
        self._rests_s.clear()
        self.bare = "map"
        self._chosen = not (self._offers and (self.governs or self._hurries))
        self._wish = self._first_wish()
        timed = self.refine == "auto" or (self._hurries and self._usual > 0)
        most = None if self._wish == MOST_STEPS else self._wish
        self._time = None
        if timed and self._limit_s is not None:
            self._time = StepBudget(self._limit_s, most, self._clean_steps())

    def _clean_steps(self) -> int:
        """Return the fewest steps that leave a clean picture; 0 if a budget or a promise decides."""
        offer = next((offer for offer in self._offers if offer.start == self.start), None)
        return 0 if self.governs or offer is None else min(offer.curve.clean_steps, self._wish)

    def _first_wish(self) -> int:
        if self.refine != "auto":
            return self.refine
        if self.within != "no" or self._limit_s is None:
            return max(self._usual, self._least)
        return MOST_STEPS

    def _want(self, steps: int) -> None:
        self._wish = steps
        if self._time is not None:
            self._time.most = steps

    def _choose(self, rest_s: float, start_s: float, step_s: float) -> None:
        """Choose the start, once after each change of the options.

        Without a budget or a promise, the start is T⁺ if T⁺ fits into a frame. A budget chooses the start that comes
        nearest to the optimum in time. A promise chooses the start that keeps the promise soonest.

        rest_s : seconds of a frame without start and steps.
        start_s : seconds of the present start.
        step_s : seconds per step.
        """
        if self._chosen:
            return
        self._chosen = True
        if not self.governs:
            self._leave_what_is_late(rest_s + start_s)
            return

        def rated(offer: Offer) -> tuple[float, float]:
            began_s = start_s if offer.start == self.start else offer.in_steps * step_s
            steps, fits = MOST_STEPS, True
            if self._time is not None:
                steps, fits = self._time.fitting(rest_s + began_s, step_s), self._time.fits(rest_s + began_s)
            if self.within == "no":
                return offer.curve.at(steps) if fits else math.inf, began_s
            steps = min(offer.curve.least(self.within), steps)
            return max(offer.curve.at(steps), self.within), began_s + steps * step_s

        self.start = min(self._offers, key=rated).start

    def _leave_what_is_late(self, seconds: float) -> None:
        """Switch to direct mapping and the steps that it needs, if T⁺ takes too long for a frame.

        Switches only if direct mapping gives a clean picture in less time.

        seconds : time of a frame without steps.
        """
        if self._time is None or self._time.fits(seconds) or not self._offers:
            return
        quickest = min(self._offers, key=lambda offer: offer.in_steps + offer.curve.clean_steps)
        if quickest.start == "previous-direct" != self.start:
            self.start = quickest.start
            self._want(min(quickest.curve.least(GOOD_ENOUGH_DB), MOST_OFFERED))
            self._time.least = self._clean_steps()

    def _bare_start(self, rest_s: float, step_s: float) -> str:
        in_steps = {offer.start: offer.in_steps for offer in self._offers}
        if self.budget == "no" or self._time is None or "previous-direct" not in in_steps:
            return "map"
        return "map" if self._time.fits(rest_s + in_steps.get("previous", 0.0) * step_s) else "direct"

    def _check_budget(self, seconds: float, steps: int, stage_s: Mapping[str, float]) -> None:
        """Notify once if even the fewest steps exceed the budget."""
        if self.budget == "no" or steps > self._least or 1000 * seconds <= self.budget:
            self._late = 0
            return
        self._late += 1
        if self._late >= TRIES and not self._said and stage_s:
            self._said = True
            stages = ", ".join(f"{stage} {1000 * each:.1f}" for stage, each in stage_s.items())
            self.notice(
                f"--budget {self.budget:g} cannot be kept: with {steps} steps a frame takes {1000 * seconds:.0f} ms "
                f"({stages}); {remedy(stage_s)}"
            )

    def _check_promise(self, found: Shortfall) -> None:
        """Notify once if the time or the largest number of steps cannot keep the promise."""
        self._misses = self._misses + 1 if self.steps <= found.steps else 0
        if self._misses >= self.looks and not self._said:
            self._said = True
            limit = "" if self._limit_s is None else f" in {1000 * self._limit_s:.3g} ms a frame"
            self.notice(
                f"--within {self.within:g} cannot be kept: at most {self.steps} steps{limit}, and {found.steps} end "
                f"{found.decibels:.2g} dB below the optimum, as many again would bring {found.doubling:.2g}; give a "
                "larger --within or, for more steps, a larger --budget or a medium of a lower rate"
            )


REMEDIES = {
    "linear": "play a smaller medium",
    "place": "calibrate with a smaller camera view",
    "start": "build a smaller correction map (counterlight build --inverse none), or calibrate with fewer pixels",
    "steps": "build smaller maps (counterlight build --max-error 2)",
    "view": "show the projector's view",
    "encode": "use a projector of fewer pixels, or a faster GPU",
}


def remedy(stage_s: Mapping[str, float]) -> str:
    """Return the advice that shortens the longest stage."""
    return REMEDIES[max(stage_s, key=lambda stage: stage_s[stage])]


def draw(
    renderer: AnyRenderer,
    governor: Governor,
    stats: Stats,
    view: str,
    *,
    compensate: bool,
    frame: int,
    timed: bool = True,
) -> int:
    """Render the uploaded frame, report its times to the governor and the statistics, and return its steps.

    timed : also measure each stage, for which the renderer waits after each stage.
    """
    start, steps = time.perf_counter(), governor.steps
    renderer.start_from(governor.start, governor.bare)
    renderer.render(view, compensate=compensate, frame=frame, steps=steps, timed=timed)
    renderer.finish()
    seconds, stage_s = time.perf_counter() - start, renderer.stage_s if timed else {}
    stats.add("gpu", seconds)
    stats.add_stages(stage_s, steps)
    governor.took(seconds, steps, stage_s)
    return steps

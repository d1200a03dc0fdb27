"""The best way to play a room: a start of refinement, and the fewest steps that suffice (docs/refinement.md).

The build measures the error that the player's own steps leave, on a few squares of the camera picture (pictures.py) and
the typical pictures. It ignores far light, and ties between projector rows: both hardly change the gain of a step.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import numpy as np

from counterlight.arrays import BoolArray, FloatArray, IntArray
from counterlight.maps.prior import Prior
from counterlight.maps.row_map import SparseRows
from counterlight.pipeline.refinement import GOOD_ENOUGH_DB, MOST_OFFERED, Curve
from counterlight.tools.inverse.pictures import squares_of, typical_pictures
from counterlight.tools.transport.objective import Objective
from counterlight.tools.transport.transport import Transport

MEASURED = (0, 2, 4, 8, 16)
OFFERED = (4, 8, MOST_OFFERED)  # numbers of steps offered in a window
MANY_STEPS = 64  # number of steps whose result counts as the optimum
FAINTEST_ERROR = 1e-5  # share of white²; a smaller error is not visible: it is 50 dB below white


@dataclass(frozen=True)
class Recommendation:
    """The recommended start and steps.

    start : one of the player's STARTS.
    steps : steps per frame.
    below_optimum : by start, dB below the unweighted optimum after MEASURED steps.
    priors : part of `below_optimum`, in dB, that weights and priors cost, after MANY_STEPS.

    For the T⁺ of chapter 5, nothing is measured: it includes far light, which is ignored here.
    """

    start: str
    steps: int
    below_optimum: dict[str, tuple[float, ...]]
    priors: float = 0.0

    def after(self, steps: int) -> float:
        """Return dB below the optimum after one of the MEASURED numbers of steps from the start."""
        return self.below_optimum[self.start][MEASURED.index(steps)]

    @property
    def clean_steps(self) -> int:
        """The fewest steps for a clean picture. On a slow machine, the player reduces its steps to this number."""
        if self.start not in self.below_optimum:
            return self.steps
        return min(Curve(MEASURED, self.below_optimum[self.start]).clean_steps, self.steps)

    def to_toml(self) -> dict[str, Any]:
        """Return the table for the maps' manifest."""
        curves = {name: [round(value, 3) for value in curve] for name, curve in self.below_optimum.items()}
        costs = {"steps": list(MEASURED), **curves, "priors": round(self.priors, 3)}
        measured = {"below_optimum_db": costs} if curves else {}
        return {"play": {"start": self.start, "steps": self.steps, **measured}}


AS_THE_THESIS = Recommendation("previous", 0, {})


def recommended(
    objective: Objective,
    direct: SparseRows,
    T_pinv: SparseRows | None,
    white: float,
    camera: tuple[int, int],
    pictures: Sequence[FloatArray] | None = None,
) -> Recommendation:
    """Find the start, and the fewest steps from it that end within GOOD_ENOUGH_DB.

    direct : direct mapping.
    T_pinv : T⁺ of the near light; None if there is none.
    white : radiance of a white picture.
    camera : (height, width).
    pictures : pictures to try; None for the typical ones.
    """
    squares = squares_of((objective.weights > 0).reshape(camera), objective.T.entries)
    within = objective.T.without_far.at(squares.rows)
    columns = np.flatnonzero(within.lit[:, 1])
    local, share = _local(objective, within, squares.rows, columns), _share_of_near(objective)
    direct = direct.at(columns)
    T_pinv = None if T_pinv is None else T_pinv.at(columns)
    start = "previous-direct" if T_pinv is None else "previous"
    names = dict.fromkeys((start, "previous-direct"))
    errors, least, settled = {name: np.zeros(len(MEASURED)) for name in names}, 0.0, 0.0
    judge = _Judge(local.unweighted, squares.inner)
    for picture in typical_pictures(camera) if pictures is None else pictures:
        asked = np.repeat(white * picture.reshape(-1, 1), 3, axis=1)
        b, wanted = objective.bounded(asked), (asked * share)[squares.rows]
        drives = {"previous-direct": direct.apply(b)}
        if T_pinv is not None:
            drives["previous"] = T_pinv.apply(b * share)
        sought, last = (b * share)[squares.rows], list[FloatArray]()
        for name, drive in drives.items():
            steps = _marked(local.steps(np.clip(drive, 0, 1), sought), (*MEASURED, MANY_STEPS))
            errors[name] += [judge.error(p, wanted) for p in steps[:-1]]
            last.append(steps[-1])
        nearest = min(last, key=lambda p: judge.error(p, wanted))
        settled += judge.error(nearest, wanted)
        least += judge.error(_marked(judge.objective.steps(nearest, wanted), (MANY_STEPS,))[0], wanted)
    floor = FAINTEST_ERROR * white**2 * 3 * np.count_nonzero(squares.inner)

    def below(error: float) -> float:
        return float(max(10 * np.log10((error + floor) / (least + floor)), 0))

    curves = {name: tuple(below(float(error)) for error in curve) for name, curve in errors.items()}
    return Recommendation(start, _steps(curves[start], below(settled)), curves, below(settled))


def _steps(curve: tuple[float, ...], priors: float) -> int:
    """Return the fewest steps that end within GOOD_ENOUGH_DB of the limit."""
    enough = [steps for steps in OFFERED if curve[MEASURED.index(steps)] <= priors + GOOD_ENOUGH_DB]
    return enough[0] if enough else OFFERED[-1]


@dataclass(frozen=True)
class _Judge:
    """Measures errors.

    objective : the unweighted objective.
    inner : (camera pixels,) bool. Pixels that are judged.
    """

    objective: Objective
    inner: BoolArray

    def error(self, p: FloatArray, b: FloatArray) -> float:
        """Return Σ (T p − b)² over the inner lit camera pixels."""
        lit = self.inner if self.objective.lit is None else self.inner & self.objective.lit
        return float(np.sum((self.objective.T.apply(p) - b)[lit] ** 2))


def _marked(steps: Iterator[FloatArray], marks: tuple[int, ...]) -> list[FloatArray]:
    """Return the drives after the numbers of steps in `marks`."""
    return [p for step, p in enumerate(islice(steps, marks[-1] + 1)) if step in marks]


def _local(objective: Objective, within: Transport, rows: IntArray, columns: IntArray) -> Objective:
    """Return the objective of some camera and projector pixels, arranged in one line; true neighbours keep their ties.

    within : T of these camera pixels, without far light.
    """
    prior = objective.prior
    if prior is not None:
        following = np.append(np.diff(columns) == 1, [False])[:, None]
        right = prior.right.reshape(-1, 3)[columns] * following
        damping = prior.damping.reshape(-1, 3)[columns]
        prior = Prior(*(each[None].astype(np.float32) for each in (damping, right, np.zeros_like(right))))
    T, weights, seen = within.of_columns(columns), objective.weights[rows], objective.seen[columns]
    lit = None if objective.lit is None else objective.lit[rows]
    return replace(objective, T=T, weights=weights, prior=prior, seen=seen, lit=lit)


def _share_of_near(objective: Objective) -> FloatArray:
    """Return near light as a share of all light of a white projector, (camera pixels, 3)."""
    if objective.T.far is None:
        return np.ones((objective.T.shape[0], 3))
    near, all_light = objective.T.without_far.composition(), objective.T.composition()
    return np.divide(near, all_light, out=np.zeros_like(near), where=all_light > 0)

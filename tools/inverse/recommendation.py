"""How a room is best played: where refinement starts, and the steps that it needs (docs/refinement.md).

Measured when the maps are built, on a few squares of the camera's picture (squares.py) and the typical pictures, by the
player's own steps. Far light is left aside, and ties between projector rows: both change what a step gains by little.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import numpy as np

from counterlight.arrays import BoolArray, FloatArray, IntArray
from counterlight.maps.prior import Prior
from counterlight.maps.row_map import SparseRows
from counterlight.tools.inverse.pictures import typical_pictures
from counterlight.tools.inverse.squares import squares_of
from counterlight.tools.transport.objective import Objective
from counterlight.tools.transport.transport import Transport

MEASURED = (0, 2, 4, 8, 16)
OFFERED = (4, 8, 16)  # steps that a window is asked for
GOOD_ENOUGH_DB = 0.1  # below the optimum: nobody could tell
MANY_STEPS = 64  # what stands for the optimum
FAINTEST_ERROR = 1e-5  # of white², below which more does not show: 50 dB


@dataclass(frozen=True)
class Recommendation:
    """start : of the player's STARTS.  steps : a frame.  below_optimum : dB after MEASURED steps from each start.

    Nothing is measured for the thesis' own T⁺: far light, which is left aside here, is in it.
    """

    start: str
    steps: int
    below_optimum: dict[str, tuple[float, ...]]

    def after(self, steps: int) -> float:
        """dB below the optimum after some of the MEASURED steps from the start."""
        return self.below_optimum[self.start][MEASURED.index(steps)]

    def to_toml(self) -> dict[str, Any]:
        """For the maps' manifest."""
        curves = {name: [round(value, 3) for value in curve] for name, curve in self.below_optimum.items()}
        measured = {"below_optimum_db": {"steps": list(MEASURED), **curves}} if curves else {}
        return {"play": {"start": self.start, "steps": self.steps, **measured}}


AS_THE_THESIS = Recommendation("previous", 0, {})


def recommended(
    objective: Objective,
    direct: SparseRows,
    T_pinv: SparseRows | None,
    map_in_steps: float,
    white: float,
    camera: tuple[int, int],
    pictures: Sequence[FloatArray] | None = None,
) -> Recommendation:
    """Where to start and how many steps to make, so that the least is read a frame.

    direct : direct mapping.  T_pinv : of the near light, None if there is none.  map_in_steps : what T⁺ b takes.
    white : radiance of a white picture.  camera : (height, width).  pictures : to try; None for the typical ones.
    """
    squares = squares_of((objective.weights > 0).reshape(camera), objective.T.entries)
    within = objective.T.without_far.at(squares.rows)
    columns = np.flatnonzero(within.lit[:, 1])
    local, share = _local(objective, within, squares.rows, columns), _share_of_near(objective)
    direct = direct.at(columns)
    costs = {"previous-direct": direct.indices.size / max(2 * objective.T.entries, 1)}
    if T_pinv is not None:
        costs["previous"], T_pinv = map_in_steps, T_pinv.at(columns)
    errors, least = {name: np.zeros(len(MEASURED)) for name in costs}, 0.0
    for picture in typical_pictures(camera) if pictures is None else pictures:
        b = objective.bounded(np.repeat(white * picture.reshape(-1, 1), 3, axis=1))
        drives = {"previous-direct": direct.apply(b)} | (
            {} if T_pinv is None else {"previous": T_pinv.apply(b * share)}
        )
        wanted = (b * share)[squares.rows]
        for name, drive in drives.items():
            errors[name] += list(_errors(local, np.clip(drive, 0, 1), wanted, squares.inner, MEASURED))
        nearest = np.clip(drives[min(drives, key=lambda name: errors[name][-1])], 0, 1)
        least += min(_errors(local, nearest, wanted, squares.inner, (*MEASURED, MANY_STEPS)))
    floor = FAINTEST_ERROR * white**2 * 3 * np.count_nonzero(squares.inner)
    below = {
        name: tuple(float(max(each, 0)) for each in 10 * np.log10((curve + floor) / (least + floor)))
        for name, curve in errors.items()
    }
    steps = {name: _steps(curve) for name, curve in below.items()}
    start = min(steps, key=lambda name: costs[name] + steps[name])
    return Recommendation(start, steps[start], below)


def _steps(curve: tuple[float, ...]) -> int:
    enough = [steps for steps in OFFERED if curve[MEASURED.index(steps)] <= GOOD_ENOUGH_DB]
    return enough[0] if enough else OFFERED[-1]


def _errors(
    objective: Objective, drive: FloatArray, b: FloatArray, inner: BoolArray, marks: tuple[int, ...]
) -> Iterator[float]:
    """Σ w (T p − b)² of the inner camera pixels after so many of the player's steps from a drive."""
    for step, p in enumerate(islice(objective.steps(drive, b), marks[-1] + 1)):
        if step in marks:
            squared = objective.weights[:, None] * (objective.T.apply(p) - b) ** 2
            yield float(squared[inner].sum())


def _local(objective: Objective, within: Transport, rows: IntArray, columns: IntArray) -> Objective:
    """The objective of some camera and projector pixels, those in one line, tied to the next where it is next.

    within : T of these camera pixels, without far light.
    """
    prior = objective.prior
    if prior is not None:
        following = np.append(np.diff(columns) == 1, [False])[:, None]
        right = prior.right.reshape(-1, 3)[columns] * following
        damping = prior.damping.reshape(-1, 3)[columns]
        prior = Prior(*(each[None].astype(np.float32) for each in (damping, right, np.zeros_like(right))))
    T, weights, seen = within.of_columns(columns), objective.weights[rows], objective.seen[columns]
    return replace(objective, T=T, weights=weights, prior=prior, seen=seen)


def _share_of_near(objective: Objective) -> FloatArray:
    """Near light of all light of a white projector, (camera pixels, 3)."""
    if objective.T.far is None:
        return np.ones((objective.T.shape[0], 3))
    near, all_light = objective.T.without_far.composition(), objective.T.composition()
    return np.divide(near, all_light, out=np.zeros_like(near), where=all_light > 0)

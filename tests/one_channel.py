"""Solve min ‖T p − b‖ for one matrix T: the solvers take three channels, so the other two are dark."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from counterlight.pipeline.refinement import Certificate
from counterlight.tools.clusters.components import refuse_not_finite
from counterlight.tools.solve.channel import Channel
from counterlight.tools.solve.registry import prepare
from counterlight.tools.transport.objective import Objective
from counterlight.tools.transport.transport import Csr, Transport

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class System:
    """System of one channel.

    near : T, (camera pixels, projector pixels).
    target : b, (camera pixels,).
    """

    near: Csr
    target: FloatArray

    @property
    def shape(self) -> tuple[int, int]:
        return self.near.shape

    @cached_property
    def T(self) -> Transport:  # noqa: N802
        return Channel(self.near).alone()

    @property
    def b(self) -> FloatArray:
        return beside_dark(self.target)

    def squared_error(self, p: FloatArray) -> float:
        return float(np.sum((self.near @ p - self.target) ** 2))


@dataclass(frozen=True)
class Found:
    """Solution; `unclamped` and `drive` are (projector pixels,)."""

    unclamped: FloatArray
    notes: tuple[str, ...]

    @property
    def drive(self) -> FloatArray:
        return np.clip(self.unclamped, 0, 1)


def beside_dark(values: FloatArray) -> FloatArray:
    """Returns (n,) as (n, 3), with 0 in the other channels."""
    dark = np.zeros_like(values)
    return np.stack([values, dark, dark], axis=1)


def linear_system(T: Csr | ArrayLike, b: ArrayLike) -> System:
    system = System(sparse.csr_array(T).astype(np.float64), np.array(b, np.float64))
    refuse_not_finite(system.T.near, system.b)
    return system


def solve(name: str, system: System) -> Found:
    found = prepare(name, system.T).solve(system.b)
    notes = tuple(note.removeprefix("red: ") for note in found.notes if note.startswith("red: "))
    return Found(found.unclamped[:, 0], notes)


def certificate(system: System, drive: FloatArray) -> Certificate:
    return Objective.plain(system.T).certificate(beside_dark(drive), system.b)


def relative_gap(system: System, drive: FloatArray) -> float:
    return float(Objective.plain(system.T).relative_gap(beside_dark(drive), system.b)[0])

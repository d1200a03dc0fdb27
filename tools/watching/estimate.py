"""Find the changes of the room from the last seconds. A change must predict other captures better to be applied.

Two of three captures are fitted, and every third is held back. A candidate θ replaces the applied θ only if it predicts
the held-back captures better. Components return to the applied value if the prediction does not get worse.
Directions of θ that the captures do not determine keep their values (eigenvalues of the information matrix).
"""

from collections import deque
from dataclasses import dataclass, replace
from functools import reduce
from operator import add

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray
from counterlight.tools.watching.evidence import CAMERA, Compared, Evidence, Layout

WINDOWS_S = 20.0, 10.0, 5.0, 2.5  # captures that are fitted; a shorter window is used after a change
HOLD_BACK = 3
FASTEST = 0.1  # expected speed of a steady drift, pixels per second
FEWEST = 2  # fitted captures of a window
UNSURE_PX, UNSURE_LIGHT, UNSURE_CAMERA = 0.1, 0.03, 0.1  # largest standard deviations of components that may be changed
UNSURE_AMBIENT, UNSURE_EVEN = 0.004, 0.02  # error of the field of ambient light, and of its mean
STILL_PX, STILL_LIGHT, STILL_AMBIENT = 0.02, 0.01, 0.001  # smaller changes are ignored
INFORMATION = 0.02  # share of the evidence that counts, because errors of T repeat in every capture
SETTLE_S = WINDOWS_S[0]  # time after a change; the first estimate comes from few captures, and small changes improve it
WORTH = 2.0  # least improvement of the held-back captures, in units of ½ χ²
NEW = 0.03  # change of the picture, RMS of drive, from which on a capture counts fully
OLD = 0.1  # weight of a capture of the same picture, relative to a full weight
COARSE = 1.5  # rounding errors that a whole picture may have in common
DIM = 0.05  # share of white; in a darker film, noise does not blur code values
CAMERA_MOVED = 0.1  # camera pixels; a camera with a smaller shift has not moved
VISIBLE = 4.0  # standard deviations of the texture's place; a larger movement of the camera would be seen in it


@dataclass(frozen=True)
class Record:
    """The evidence of a capture; `held` captures are not fitted.

    still : least changes of gains and of ambient light that rounded code values allow to see.
    """

    time_s: float
    evidence: Evidence
    held: bool
    still: tuple[float, float]


@dataclass(frozen=True)
class Found:
    """A candidate for θ.

    theta : (n,).
    unsure : (n,). Standard deviation of each component.
    known : share of the geometry's directions that the captures determine, per projector.
    better : improvement of the held-back captures over the applied θ.
    camera : how much a movement of the wall's texture, and thus of a camera, improves the prediction of the held-back
        captures; 0 if the texture has not moved.
    texture : whether the captures determine the texture's place well enough: they would show if a moved camera, and not
        a moved projector, were the cause of θ.
    which : number of the camera that has moved most, from 0.
    """

    theta: FloatArray
    unsure: FloatArray
    known: tuple[float, ...]
    better: float
    camera: float
    texture: bool
    which: int


class Estimate:
    """Collects evidence; `theta` is the present estimate, around which captures are compared.

    `applied` is the θ that the player has, or will have soon.

    camera_px : camera pixels per projector pixel.
    """

    def __init__(self, layout: Layout, camera_px: float) -> None:
        self.layout, self._camera_px = layout, camera_px
        self.theta: FloatArray = np.zeros(layout.size)
        self.applied: FloatArray = np.zeros(layout.size)
        self._records: deque[Record] = deque()
        self._count, self._settled_s = 0, -np.inf
        self._units = _units(layout)
        self._free = np.setdiff1d(np.arange(layout.size), layout.camera)

    def add(self, time_s: float, compared: Compared, change: float) -> None:
        """Take a capture; `change` is the RMS change of its picture since the previous one."""
        share = information(change)
        self._count += 1
        held = self._count % HOLD_BACK == 0
        error, bright = COARSE * compared.coarse, max(compared.brightness, 1e-3)
        still = max(STILL_LIGHT, error / bright), max(STILL_AMBIENT, error * min(1.0, DIM / bright))
        self._records.append(Record(time_s, compared.evidence.scaled(share), held, still))
        while self._records[0].time_s < time_s - WINDOWS_S[0]:
            self._records.popleft()

    def apply(self, theta: FloatArray) -> None:
        """Take note that the player will apply θ."""
        now_s = self._records[-1].time_s
        if now_s > self._settled_s and not np.array_equal(theta, self.applied):
            self._settled_s = now_s + SETTLE_S
        self.applied = theta

    def restart(self, theta: FloatArray) -> None:
        """Forget all captures, and continue from θ after a jump."""
        self.theta = theta
        self._records.clear()

    def find(self) -> Found | None:
        """Return the best candidate; None without enough captures."""
        best: list[Record] = []
        theta = self.applied
        for window_s in WINDOWS_S:
            records = [r for r in self._records if r.time_s > self._records[-1].time_s - window_s]
            if sum(not r.held for r in records) < FEWEST or not any(r.held for r in records):
                break
            for candidate in (records, self._drifting(records)):
                found = self._solved(self._sum(candidate, held=False), self._free)
                before = self._sum(best[-len(records) :] if best else records, held=True).cost(theta)
                if not best or before - self._sum(candidate, held=True).cost(found) > WORTH:
                    best, theta = candidate, found
        if not best:
            return None
        if len(best) < len(self._records):
            self._records = deque([*self._records][-len(best) :])
        evidence, held = (self._sum(best, held=each) for each in (False, True))
        self.theta = theta
        kept = self._simplest(theta, held, np.median([record.still for record in best], axis=0))
        unsure = np.sqrt(1 / np.maximum(np.diag(evidence.H), 1e-12))
        known = tuple(self._known(evidence, places) for places in self._geometries())
        better = held.cost(self.applied) - held.cost(kept)
        return Found(kept, unsure, known, better, *self._camera(evidence, held, theta))

    def _drifting(self, records: list[Record]) -> list[Record]:
        """Return the captures as if taken now, corrected by the steady drift of all pictures that fits best.

        The cost of θ + τ v for a capture of age −τ is quadratic in θ and v; eliminating θ leaves v.
        """
        now_s, shifts = records[-1].time_s, np.concatenate([places[:2] for places in self._geometries()])
        age = [r.time_s - now_s for r in records]
        fitted = [(r.evidence, t) for r, t in zip(records, age, strict=True) if not r.held]
        H = [sum((t**k * e.H for e, t in fitted), np.zeros((self.layout.size,) * 2)) for k in range(3)]
        b = [sum((t**k * e.b for e, t in fitted), np.zeros(self.layout.size)) for k in range(2)]
        free, units = self._free, self._units[np.ix_(self._free, self._free)]
        inverse = units @ np.linalg.inv(units.T @ H[0][np.ix_(free, free)] @ units + np.eye(free.size)) @ units.T
        across = H[1][np.ix_(shifts, free)] @ inverse
        A = H[2][np.ix_(shifts, shifts)] - across @ H[1][np.ix_(free, shifts)]
        v = np.zeros(self.layout.size)
        v[shifts] = np.linalg.solve(A + np.eye(shifts.size) / FASTEST**2, b[1][shifts] - across @ b[0][free])
        return [replace(r, evidence=r.evidence.ahead(-t * v)) for r, t in zip(records, age, strict=True)]

    def _groups(self, still: FloatArray) -> list[tuple[NDArray[np.int64], float]]:
        """Return the components that change together, and the least change of each that is applied."""
        light, ambient = (float(each) for each in still)
        projectors = range(self.layout.projectors)
        return [
            *((places, STILL_PX) for places in self._geometries()),
            *((self.layout.gain(number), light) for number in projectors),
            (self.layout.ambient, ambient),
        ]

    def _geometries(self) -> list[NDArray[np.int64]]:
        return [self.layout.geometry(number) for number in range(self.layout.projectors)]

    def _simplest(self, theta: FloatArray, held: Evidence, still: FloatArray) -> FloatArray:
        """Return θ, in which components keep their applied value if their change is small or improves nothing.

        Soon after a change, only small differences from the calibration are ignored.
        """
        kept = theta.copy()
        kept[self.layout.camera] = 0
        settling = self._records[-1].time_s <= self._settled_s
        calm = np.zeros(self.layout.size) if settling else self.applied
        for places, least in self._groups(still):
            back, near = kept.copy(), kept.copy()
            back[places], near[places] = self.applied[places], calm[places]
            if held.cost(back) - held.cost(kept) < WORTH:
                kept = back
            elif np.abs(kept - near).max() < least:
                kept = near
        return kept

    def _solved(self, evidence: Evidence, free: NDArray[np.int64]) -> FloatArray:
        """Minimise the cost over the determined directions of the free unknowns, from the applied θ."""
        theta = self.applied.copy()
        values, vectors = self._directions(evidence, free)
        units = self._units[np.ix_(free, free)]
        gradient = units.T @ (evidence.b - evidence.H @ theta)[free]
        determined = values > 1
        theta[free] += units @ (vectors[:, determined] @ ((vectors[:, determined].T @ gradient) / values[determined]))
        return theta

    def _directions(self, evidence: Evidence, free: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
        """Return the eigenvalues and vectors of the information in `_units`: above 1, a direction is determined."""
        units = self._units[np.ix_(free, free)]
        values, vectors = np.linalg.eigh(units.T @ evidence.H[np.ix_(free, free)] @ units)
        return values, vectors

    def _known(self, evidence: Evidence, places: NDArray[np.int64]) -> float:
        return float(np.mean(self._directions(evidence, places)[0] > 1))

    def _camera(self, evidence: Evidence, held: Evidence, theta: FloatArray) -> tuple[float, bool, int]:
        """Return `Found.camera`, `Found.texture` and `Found.which`; θ is the best without a movement of the texture."""
        found, places = self._solved(evidence, np.arange(self.layout.size)), self.layout.camera
        moves = np.abs(found[places]).reshape(self.layout.cameras, -1).max(axis=1)
        better = held.cost(theta) - held.cost(found) if moves.max() >= CAMERA_MOVED else 0.0
        known = self._known(evidence, places) == 1 or self._unsure_texture(evidence) < self._moved_px(theta) / VISIBLE
        return better, known, int(moves.argmax())

    def _unsure_texture(self, evidence: Evidence) -> float:
        """Return the largest standard deviation of a shift of any camera's texture alone, camera pixels."""
        shifts = self.layout.camera.reshape(self.layout.cameras, CAMERA)[:, :2]
        least = min(float(np.linalg.eigvalsh(evidence.H[np.ix_(each, each)])[0]) for each in shifts)
        return float(1 / np.sqrt(max(least, 1e-12)))

    def _moved_px(self, theta: FloatArray) -> float:
        """Return how far the middle of a picture has moved since the applied θ, camera pixels."""
        shifts = [(theta - self.applied)[places[:2]] for places in self._geometries()]
        return self._camera_px * max(float(np.hypot(*each)) for each in shifts)

    def _sum(self, records: list[Record], *, held: bool) -> Evidence:
        chosen = (record.evidence for record in records if record.held is held)
        return reduce(add, chosen, Evidence.none(self.layout.size))


def information(change: float) -> float:
    """Return the share of a capture's evidence that counts, from the RMS change of its picture since the previous."""
    return INFORMATION * float(np.clip(change / NEW, OLD, 1))


def _units(layout: Layout) -> FloatArray:
    """Return the largest allowed deviations of components, (n, n); the mean of ambient light is allowed more."""
    units = np.full(layout.size, UNSURE_PX)
    units[layout.all_gains], units[layout.camera] = UNSURE_LIGHT, UNSURE_CAMERA
    found, even = np.diag(units), np.full((layout.field, layout.field), 1 / layout.field)
    for cells in layout.ambient.reshape(-1, layout.field):
        found[np.ix_(cells, cells)] = UNSURE_AMBIENT * np.eye(layout.field) + UNSURE_EVEN * np.sqrt(layout.field) * even
    return found

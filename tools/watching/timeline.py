"""Which frames a capture saw: the latency of the camera from changes of the film, and the mean picture of an exposure.

A capture that arrives at time t has seen the light of t − L − E to t − L. L, the latency, and E, the exposure, are
found from the differences d between successive captures, as means over coarse regions. They minimise Σ |d − d'(L, E)|²,
where d' is predicted from the mean light of the frames during the exposure.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray
from counterlight.unattended.watch_link import Light, Picture

KEPT_S = 120.0  # seconds for which light is kept
PICTURES_S = 3.0  # seconds for which pictures are kept
MOST_LATENCY_S = 0.4
STEPS_S = 0.004  # step of the search for the latency
CAPTURES = 150  # most captures of the search
FEWEST = 8
EXPLAINED = 0.3  # share of the changes that the best latency must explain
INDEPENDENT = 8  # number of independent values in a capture, over all its regions and channels
CLEAR, SURE = 30.0, 9.0  # log likelihood ratios (χ²) of a latency further away, and of the deviation of the best
AWAY = 3.0  # refreshes of the display; latencies further from the best must be clearly worse
SAME = 2e-3  # change of the light, RMS of drive; less is no change


@dataclass(frozen=True)
class Window:
    """When a capture was exposed: between `first_s` and `last_s`, each with the same uncertainty.

    unsure_s : largest error of both times.
    """

    first_s: float
    last_s: float
    unsure_s: float


@dataclass(frozen=True)
class Exposed:
    """The mean picture of an exposure, (height, width, 3), and half its difference if the exposure were later."""

    picture: FloatArray
    change: FloatArray


@dataclass(frozen=True)
class Latency:
    """L and E, named `latency_s` and `exposure_s`.

    unsure_s : largest error of L.
    known : whether the film has determined L and E.
    """

    latency_s: float
    exposure_s: float
    unsure_s: float
    known: bool


class Timeline:
    """The frames that were displayed recently, and the recent captures.

    coarse : (3, regions, cells), from `RoomView.coarse`.
    exposure_s : E; None if it is unknown.
    follows : whether captures arrive at the end of their exposure.
    """

    def __init__(self, coarse: FloatArray, exposure_s: float | None, refresh_s: float, *, follows: bool) -> None:
        self._coarse, self._refresh_s = coarse, refresh_s
        self._given = exposure_s
        # of each displayed frame: when it was shown, the regions' light that it predicts, and the number of its picture
        self._times: deque[float] = deque()
        self._predicted: deque[FloatArray] = deque()
        self._numbers: deque[int] = deque()
        self._grid: NDArray[np.float32] | None = None  # of the first frame with the last number
        self._number = 0
        self._pictures: deque[Picture] = deque()
        self._captures: deque[tuple[float, FloatArray]] = deque(maxlen=CAPTURES)
        widest = 0.0 if follows else MOST_LATENCY_S / 2
        self.latency = Latency(widest, exposure_s or 0.0, widest, known=follows)
        self._follows = follows

    def light(self, light: Light) -> None:
        if self._grid is None or np.abs(light.grid - self._grid).max() >= SAME:
            self._grid = light.grid
            self._number += 1
        self._times.append(light.time_s)
        self._predicted.append(np.einsum("krc,ck->rk", self._coarse, light.grid.reshape(-1, 3)))
        self._numbers.append(self._number)
        while self._times[0] < light.time_s - KEPT_S:
            for kept in (self._times, self._predicted, self._numbers):
                kept.popleft()

    def picture(self, picture: Picture) -> None:
        self._pictures.append(picture)
        while len(self._pictures) > 2 and self._pictures[1].time_s < picture.time_s - PICTURES_S:
            self._pictures.popleft()

    def captured(self, time_s: float, regions: FloatArray) -> None:
        """Take a capture's light above ambient, (regions, 3)."""
        self._captures.append((time_s, regions))

    def window(self, time_s: float) -> Window:
        """Return when a capture that arrived at `time_s` was exposed."""
        last = time_s - self.latency.latency_s
        return Window(last - self.latency.exposure_s, last, self.latency.unsure_s)

    def knows(self, window: Window) -> bool:
        """Whether the pictures are known for all of a window and its uncertainty."""
        return self._shown(window) is not None

    def seen(self, window: Window) -> Exposed | None:
        """Return the mean picture of a window; None if it is not known."""
        found = self._shown(window)
        if found is None:
            return None
        shown, pictures = found
        drives = [picture.drive.astype(np.float32) for picture in pictures]
        early, mean, late = (
            _weighted(drives, shown, window.first_s + shift, window.last_s + shift)
            for shift in (-window.unsure_s, 0.0, window.unsure_s)
        )
        return Exposed(mean, (late - early) / 2)

    def _shown(self, window: Window) -> tuple[list[float], list[Picture]] | None:
        """Return the changes of the picture in a window and its uncertainty, and the pictures from then on."""
        first, last = window.first_s - window.unsure_s, window.last_s + window.unsure_s
        if not self._times or self._times[0] > first or not self._pictures:
            return None
        times = np.array(self._times)
        shown, pictures = self._changes(times, first, last), list[Picture]()
        for time_s in shown:
            picture = self._picture_of(times, time_s)
            if picture is None:
                return None
            pictures.append(picture)
        return shown, pictures

    def _changes(self, times: FloatArray, first_s: float, last_s: float) -> list[float]:
        """Return the times of the frames that stand between two times, without frames equal to their predecessor."""
        begin = int(np.searchsorted(times, first_s, side="right")) - 1
        end = int(np.searchsorted(times, last_s, side="left"))
        changed = (i for i in range(begin + 1, end) if self._numbers[i] != self._numbers[i - 1])
        return [float(times[i]) for i in (begin, *changed)]

    def _picture_of(self, times: FloatArray, time_s: float) -> Picture | None:
        """Return the picture of the frame shown at a time, or of an equal frame."""
        number = self._number_at(times, time_s)
        same = (each for each in reversed(self._pictures) if self._number_at(times, each.time_s) == number)
        return next(same, None)

    def _number_at(self, times: FloatArray, time_s: float) -> int:
        """Return the number of the picture that stands at a time; 0 before the first."""
        index = int(np.searchsorted(times, time_s, side="right")) - 1
        return self._numbers[index] if index >= 0 else 0

    def find(self) -> None:
        """Estimate latency and exposure from the captures so far."""
        if self._follows or len(self._captures) < FEWEST or len(self._times) < 2:
            return
        times = np.array([time for time, _ in self._captures])
        covered = times > self._times[0] + MOST_LATENCY_S + self._refresh_s
        if covered.sum() < FEWEST:
            return
        differences = np.diff(np.stack([seen for _, seen in self._captures])[covered], axis=0)
        total = float(np.sum(differences**2))
        if total <= 0:
            return
        lags, exposures = np.arange(0.0, MOST_LATENCY_S, STEPS_S), self._exposures()
        integral = _Integral(np.array(self._times), np.stack(self._predicted))
        costs = np.array([[self._cost(integral, times[covered], differences, L, E) for L in lags] for E in exposures])
        number, lag = np.unravel_index(np.argmin(costs), costs.shape)
        least, along = float(costs[number, lag]), costs[number]
        worse = INDEPENDENT * len(differences) * np.log(along / max(least, 1e-30))
        away = np.abs(lags - lags[lag]) > AWAY * self._refresh_s
        if least > (1 - EXPLAINED) * total or worse[away].min() < CLEAR:
            return
        near = lags[worse < SURE]
        unsure = max(self._refresh_s / 4, STEPS_S, float(np.ptp(near)) / 2)
        self.latency = Latency(float(near.mean()), float(exposures[number]), unsure, known=True)

    def _exposures(self) -> FloatArray:
        if self._given is not None:
            return np.array([self._given])
        return self._refresh_s * np.array([0.05, 0.5, 1, 1.5, 2, 3])

    def _cost(self, integral: "_Integral", times: FloatArray, differences: FloatArray, L: float, E: float) -> float:
        predicted = np.diff(integral.mean(times - L - E, times - L), axis=0)
        return float(np.sum((predicted - differences) ** 2))


class _Integral:
    """The integral over time of light that is constant between its changes."""

    def __init__(self, times: FloatArray, lights: FloatArray) -> None:
        self._times, self._lights = times, lights
        steps = np.diff(times)[:, None, None] * lights[:-1]
        self._sums = np.concatenate([np.zeros((1, *lights.shape[1:])), np.cumsum(steps, axis=0)])

    def mean(self, first: FloatArray, last: FloatArray) -> FloatArray:
        """Return the mean light between times, (n, regions, 3)."""
        length = np.maximum(last - first, 1e-6)[:, None, None]
        return np.asarray((self._at(first + length[:, 0, 0]) - self._at(first)) / length)

    def _at(self, times: FloatArray) -> FloatArray:
        i = np.clip(np.searchsorted(self._times, times, side="right") - 1, 0, len(self._times) - 1)
        return np.asarray(self._sums[i] + (times - self._times[i])[:, None, None] * self._lights[i])


def _weighted(drives: list[NDArray[np.float32]], shown: list[float], first_s: float, last_s: float) -> FloatArray:
    """Return the mean of pictures between two times; each picture stands until the time of the next one."""
    last_s = max(last_s, first_s + 1e-6)
    edges = np.clip([*shown, np.inf], first_s, last_s)
    edges[0] = first_s
    weights = np.diff(edges) / (last_s - first_s)
    return np.asarray(sum(weight * drive for weight, drive in zip(weights, drives, strict=True)), np.float64)

"""A camera that watches a film in a rig: latency, jitter, a rolling exposure, and a room that changes meanwhile."""

from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.rig.rays import FloatArray
from tests.rig.rig import Devices, Rig

Codes = NDArray[np.uint8]
STEP_PX = 0.05  # shifts of the projector are rounded to this, so that few transports are computed


@dataclass(frozen=True)
class WatchCamera:
    """A free-running camera.

    period_s : between captures.
    latency_s : time from the end of an exposure to the arrival of the capture.
    exposure_s : exposure of each row.
    rolling_s : between the exposures of the first and the last row.
    jitter_s : standard deviation of the arrival.
    """

    period_s: float = 1 / 30
    latency_s: float = 0.07
    exposure_s: float = 1 / 60
    rolling_s: float = 0.01
    jitter_s: float = 0.003
    automatic: bool = False  # the exposure follows the brightness of the film
    seed: int = 0


@dataclass(frozen=True)
class Frame:
    """A displayed frame: `codes` from `time_s` on."""

    time_s: float
    codes: Codes


def since(change_s: float, **changes: Any) -> Callable[[Devices, float], Devices]:
    """Returns a function (devices before the change, time) that gives the devices at that time."""
    return lambda before, time_s: replace(before, **changes) if time_s >= change_s else before


def door(before: Devices, time_s: float) -> Devices:
    """Triples the room's light within two seconds, in eight steps, so that few rigs are made."""
    opened = round(8 * min(max(time_s / 2, 0.0), 1.0)) / 8
    return replace(before, room_light=before.room_light * (1 + 2 * opened))


def crossing(time_s: float, view: tuple[int, int], *, light: float, top: float = 0.0) -> FloatArray:
    """A figure a quarter of the view wide that crosses the view in a minute.

    light : share of the light that reaches the camera through the figure.
    top : share of the view above the figure.
    """
    height, width = view
    left, share = int(1.25 * width * time_s / 60) - width // 4, np.ones(view)
    share[round(top * height) :, max(left, 0) : max(left + width // 4, 0)] = light
    return share


def dust(time_s: float, view: tuple[int, int]) -> FloatArray | None:
    """From 0 s on, a soft spot of the wall reflects 80 % of its light."""
    y, x = (np.mgrid[: view[0], : view[1]] + 0.5) / view[0]
    return None if time_s < 0 else 1 - 0.2 * np.exp(-((y - 0.4) ** 2 + (x - 0.6) ** 2) / 0.02)


def poster(time_s: float, view: tuple[int, int]) -> FloatArray | None:
    """From 0 s on, a poster has fallen: a rectangle, a tenth of the view, reflects 60 % of the red light."""
    share = np.ones((*view, 3))
    share[view[0] // 3 : 2 * view[0] // 3, view[1] // 3 : round(0.63 * view[1]), 0] = 0.6
    return None if time_s < 0 else share


def standing(time_s: float, view: tuple[int, int]) -> FloatArray | None:
    """A person stands in a sixth of the view for a minute, and darkens the light to 70 %."""
    share = np.ones(view)
    share[view[0] // 4 :, view[1] // 2 : 7 * view[1] // 10] = 0.7
    return share if 0 <= time_s < 60 else None


class WatchedRoom:
    """A rig that changes during a film.

    camera : may be replaced during the film.
    devices : the devices at a time.
    person : the share of light that reaches the camera's pixels at a time, (camera height, camera width) or one per
        channel, if any.
    """

    def __init__(
        self,
        rig: Rig,
        camera: WatchCamera,
        devices: Callable[[float], Devices],
        person: Callable[[float], FloatArray | None] = lambda time_s: None,
    ) -> None:
        self._rig, self.camera, self._devices, self._person = rig, camera, devices, person
        self._rng = np.random.default_rng(camera.seed)
        self._rigs: dict[Any, Rig] = {}
        self._automatic = 1.0

    def capture(self, time_s: float, frames: Sequence[Frame]) -> tuple[float, NDArray[np.uint8]]:
        """Expose until `time_s`; returns the arrival and 8-bit codes (height, width, 3).

        frames : in order of time; the last frame stays on the screen.
        """
        camera, rig = self.camera, self.rig_at(time_s)
        height = rig.camera[0]
        last = time_s - camera.rolling_s * (1 - (np.arange(height) + 0.5) / height)
        light = np.zeros((*rig.camera, 3))
        times = [frame.time_s for frame in frames]
        start = max(bisect_right(times, last[0] - camera.exposure_s) - 1, 0)
        ends = [*times[start + 1 :], np.inf]
        for frame, end in zip(frames[start:], ends, strict=True):
            share = np.clip(np.minimum(last, end) - np.maximum(last - camera.exposure_s, frame.time_s), 0, None)
            if share.any():
                lit = rig.seen_by_camera(frame.codes).reshape(light.shape)
                light += share[:, None, None] / camera.exposure_s * lit
        seen = self._person(time_s)
        if seen is not None:
            light = light * seen.reshape(*rig.camera, -1)
        if camera.automatic:
            self._automatic += 0.3 * (0.18 / max(float(light.mean()), 1e-4) - self._automatic)
            light = light * self._automatic
        stored = rig.devices.sensor.codes(light, rig.light.weakness, self._rng)
        arrival = time_s + camera.latency_s + abs(self._rng.normal(0, camera.jitter_s))
        return arrival, np.rint(stored / 257.0).astype(np.uint8)

    def rig_at(self, time_s: float) -> Rig:
        """Returns the rig with the devices of a time; shifts are rounded, so that few rigs are made."""
        now = self._devices(time_s)
        right, down = (round(round(each / STEP_PX) * STEP_PX, 6) for each in now.shift)
        now = replace(now, shift=(right, down))
        if now not in self._rigs:
            self._rigs[now] = self._rig.after(now)
        return self._rigs[now]

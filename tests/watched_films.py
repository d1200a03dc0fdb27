"""A film in a rig that changes, in compressed time: the watcher gets frames and captures, and corrects.

The rig shares no code with the product. Only the player's pass for moved pictures is used.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from counterlight.passes.encode import encoded
from counterlight.pipeline.drift import Drift, Moved
from counterlight.show.watching import Bursts
from counterlight.tools.acquisition.cameras.camera import Exposures
from counterlight.tools.watching.view import RoomView
from counterlight.tools.watching.watcher import Watcher
from counterlight.unattended.watch_link import Answer, Light, Picture
from tests.oracles.formulas import grid_means, reduced
from tests.rig.rays import FloatArray
from tests.rig.rig import Devices, Rig
from tests.rig.watching import Frame, WatchCamera, WatchedRoom

FRAMES_PER_S = 24
ANSWER_S = 0.5
KEPT = 40  # frames that a capture can still see
Film = Callable[[float], FloatArray]
Learned = Callable[[NDArray[np.float32]], Film]


@dataclass(frozen=True)
class Scene:
    """Events during a film.

    devices : the devices at a time.
    person : share of the light that reaches the camera at a time, as in WatchedRoom, if not all of it.
    frozen_s : from then on the camera repeats its last capture.
    told : whether the watcher knows the exposure.
    """

    devices: Callable[[float], Devices]
    person: Callable[[float], FloatArray | None] = lambda time_s: None
    camera: WatchCamera = field(default_factory=WatchCamera)
    frozen_s: float = np.inf
    told: bool = True


@dataclass(frozen=True)
class Moment:
    """An answer, with the frame that was then displayed and the frame for a room without changes."""

    time_s: float
    answer: Answer
    codes: NDArray[np.uint8]
    uncorrected: NDArray[np.uint8]
    rig: Rig
    row_gains: NDArray[np.float32] | None

    @property
    def drift(self) -> Drift:
        return drift_of(self.answer)


def drift_of(answer: Answer) -> Drift:
    return Drift(tuple(Moved(np.array(each.to_raster), np.array(each.gain)) for each in answer.projectors))


def watched(
    view: RoomView, rig: Rig, film: Film, scene: Scene, seconds: float, learned: Learned | None = None
) -> Iterator[Moment]:
    """Yield the answers during a film of linear drives (height, width, 3).

    learned : returns the film that corrects row gains; without it, no frame does.
    """
    room, camera = view.room, scene.camera
    watcher = Watcher(view, camera.exposure_s if scene.told else None, 1 / FRAMES_PER_S)
    seen = WatchedRoom(rig, camera, scene.devices, scene.person)
    exposures = Exposures((1.0,), room.camera.response)
    frames, drift = list[Frame](), Drift(tuple(Moved.nothing() for _ in room.regions))
    bursts = Bursts()
    exposed_s, answered_s, shot, gains, unlearned, number_of_gains = 0.2, 0.0, None, None, film, 0
    for number in range(round(seconds * FRAMES_PER_S)):
        time_s = number / FRAMES_PER_S
        drive = film(time_s)
        codes = encoded(drift.shown(drive, room.regions), room.response)
        copy = reduced(room.response.to_linear(codes), room.regions, view.factor)
        if not frames or not np.array_equal(codes, frames[-1].codes):
            frames = [*frames[-KEPT:], Frame(time_s, codes)]
            watcher.light(Light(time_s, grid_means(copy)))
        if bursts.takes(time_s):
            watcher.picture(Picture(time_s, copy))
        while exposed_s < time_s + 1 / FRAMES_PER_S:
            arrived_s = exposed_s + camera.latency_s
            if watcher.wants(arrived_s):
                arrived_s, new = seen.capture(exposed_s, frames)
                shot = new if shot is None or exposed_s < scene.frozen_s else shot
                watcher.capture(arrived_s, shot, exposures)
            watcher.arrived(arrived_s)
            exposed_s += camera.period_s
        if time_s - answered_s >= ANSWER_S:
            answered_s, answer = time_s, watcher.answer(time_s)
            yield Moment(time_s, answer, codes, encoded(drive, room.response), seen.rig_at(time_s), gains)
            drift, bursts.exposes = drift_of(answer), answer.exposes
            if learned is not None and answer.row_gains != number_of_gains:
                number_of_gains = answer.row_gains
                gains = watcher.row_gains() if number_of_gains else None
                film = unlearned if gains is None else learned(gains)

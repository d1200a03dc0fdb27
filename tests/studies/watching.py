"""python -m tests.studies.watching: what the watcher finds during films in a rig's room, in compressed time.

The room is acquired by the documented command. The films are compensated pictures: frames of the shipped clip and
photographs. The last seconds, inside the border, are compared with the film's target.
"""

import argparse
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

import av
import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from skimage import data
from threadpoolctl import threadpool_limits

from counterlight import calibration
from counterlight.media.frames import radiance_frame
from counterlight.passes.encode import encoded
from counterlight.pipeline.correction import Correction
from counterlight.pipeline.cpu_renderer import CpuRenderer
from counterlight.pipeline.drift import Drift, Moved
from counterlight.pipeline.room import read_room
from counterlight.pipeline.shown_copies import factor_of
from counterlight.tools.colour.tiers import Tier, tier_of
from counterlight.tools.shipped import CLIP
from counterlight.tools.solve.registry import prepare
from counterlight.tools.transport.objective import DEFAULT_AIMS, objective_of
from counterlight.tools.transport.storage import read_transport
from counterlight.tools.watching.view import RoomView
from tests.rig import product
from tests.rig.faults import FAULTS
from tests.rig.judge import BORDER, decibels
from tests.rig.pictures import Picture
from tests.rig.projector import Projector
from tests.rig.rays import FloatArray
from tests.rig.rig import Devices, Rig
from tests.rig.rooms import ROOMS
from tests.rig.trial import given
from tests.rig.watching import WatchCamera, crossing, door, dust, poster, since, standing
from tests.watched_films import Film, Moment, Scene, watched

KNOWN = FAULTS["known"]
CLIP_FRAMES, HOLD_S = 24, 1.5
CHANGE_S, LAST_S = 15.0, 4.0
BRIGHT = 0.85  # share of the films' light, so that a weaker lamp can still show them
MINUTES = 12
LAMP_COLOUR = 1.0, 0.95, 0.88
STEPS = 8  # of refinement, from T⁺ b, for films that follow row gains


@dataclass(frozen=True)
class Event:
    """A change during a film.

    scene : given the devices of the calibration.
    wall : remaining share of the wall's light at a time, if the wall changes.
    """

    name: str
    film: str
    seconds: float
    scene: Callable[[Devices], Scene]
    wall: Callable[[float], FloatArray | None] | None = None

    @property
    def lasts(self) -> bool:
        """Whether the film is long enough for changes of the wall to be learned."""
        return self.seconds >= 60 * MINUTES


def later(**changes: object) -> Callable[[Devices], Scene]:
    changed = since(CHANGE_S, **changes)
    return lambda before: Scene(partial(changed, before))


def creeping(per_s: float) -> Callable[[Devices], Scene]:
    def scene(before: Devices) -> Scene:
        return Scene(lambda time_s: replace(before, shift=(per_s * max(time_s - CHANGE_S, 0.0), 0.0)))

    return scene


def changing(
    share: Callable[[float, tuple[int, int]], FloatArray | None],
) -> tuple[Callable[[Devices], Scene], Callable[[float], FloatArray | None]]:
    """Returns a scene in which something changes the light that arrives, and that change."""

    def at(time_s: float) -> FloatArray | None:
        return share(time_s - CHANGE_S, (120, 160))

    return lambda before: Scene(lambda _: before, at), at


def opened(before: Devices) -> Scene:
    """A door triples the room's light within two seconds."""
    return Scene(lambda time_s: door(before, time_s - CHANGE_S))


def automatic(before: Devices) -> Scene:
    return Scene(lambda _: before, camera=WatchCamera(automatic=True))


def crossed(before: Devices) -> Scene:
    return Scene(lambda _: before, lambda time_s: crossing(time_s - CHANGE_S, (120, 160), light=0.3))


EVENTS = (
    *(Event("nothing", film, 60, later()) for film in ("fades", "cuts", "dark", "static")),
    *(Event("jump of half a pixel", film, 35, later(shift=(0.3, 0.4))) for film in ("fades", "cuts", "dark", "static")),
    Event("jump of three pixels", "fades", 35, later(shift=(3.0, 0.0))),
    Event("drift, a pixel in ten minutes", "fades", 135, creeping(1 / 600)),
    Event("drift, eight times as fast", "fades", 90, creeping(8 / 600)),
    Event("lamp falls to 90 %", "fades", 30, later(projector=Projector(lamp=0.9))),
    Event("three times the ambient light within 2 s", "fades", 30, opened),
    Event("a person crosses", "fades", 75, crossed),
    Event("the camera moves by half a pixel", "fades", 30, later(camera_moved=(2, 0))),
    Event("the camera moves by two pixels", "fades", 30, later(camera_moved=(8, 4))),
    Event("automatic exposure", "fades", 30, automatic),
    Event("the camera stands still", "fades", 30, lambda before: Scene(lambda _: before, frozen_s=CHANGE_S)),
    *(Event(f"nothing, for {MINUTES} minutes", film, 60 * MINUTES, later()) for film in ("fades", "dark")),
    Event("nothing, for an hour", "cuts", 3600, later()),
    Event("dust: a soft spot reflects 80 %", "fades", 60 * MINUTES, *changing(dust)),
    Event("a poster falls: a rectangle reflects 60 % of red", "fades", 60 * MINUTES, *changing(poster)),
    Event("lamp colour: 100, 95 and 88 %", "fades", 60 * MINUTES, later(projector=Projector(lamp_colour=LAMP_COLOUR))),
    Event("a person stands still for a minute", "fades", 60 * MINUTES, changing(standing)[0]),
)


class Study:
    """A room, its films, and the judgement of what was shown."""

    def __init__(self, name: str, folder: Path) -> None:
        self.rig = Rig(ROOMS[name](1.0), KNOWN.devices)
        if not (folder / "room").exists():
            product.acquire(self.rig, folder, *given(KNOWN, folder))
            product.build(folder)
        stored = calibration.read(folder / "room")
        self.room, transport = stored.calibration, read_transport(stored)
        self.tier = tier_of(self.room, transport)
        self.view = RoomView(self.tier, factor_of(self.room.projector.width))
        self.drives, self.asked = _compensated(self.tier)
        inside = ndimage.binary_erosion(self.room.mask, np.ones((3, 3)), iterations=BORDER)
        self._inside = inside.ravel()
        self._renderer = CpuRenderer(replace(read_room(folder / "room", self.tier.white), start="map"))

    def parts(self, film: str, time_s: float) -> tuple[int, int, float, float]:
        """Returns two pictures, the share of the second, and the brightness of a film at a time."""
        number, since_s = divmod(time_s, HOLD_S)
        one, other = (int(7 * (number + i)) % len(self.drives) for i in range(2))
        if film == "fades":
            return one, other, float(np.clip(since_s - HOLD_S + 1, 0, 1)), BRIGHT
        return (0 if film == "static" else one), 0, 0.0, (0.03 if film == "dark" else BRIGHT)

    def film(self, event: Event, gains: NDArray[np.float32] | None = None) -> Film:
        drives = self.drives.__getitem__ if not event.lasts else cache(partial(self._played, event.film, gains))
        return lambda time_s: self._mixed(drives, event.film, time_s)

    def run(self, event: Event) -> Iterator[Moment]:
        learned = partial(self.film, event) if event.lasts else None
        scene = event.scene(KNOWN.devices)
        return watched(self.view, self.rig, self.film(event), scene, event.seconds, learned)

    def _played(self, film: str, gains: NDArray[np.float32] | None, number: int) -> NDArray[np.float32]:
        """Returns the drive of a picture as the player shows it in a room whose rows were scaled."""
        bright = self.parts(film, 0.0)[3]
        frame = radiance_frame(bright * self.asked[number] + self.room.ambient)
        self._renderer.open(frame.format)
        self._renderer.upload(frame)
        self._renderer.correct(Correction((Moved.nothing(),), row_gains=gains))
        self._renderer.render("projector", compensate=True, steps=STEPS)
        return np.asarray(self._renderer.linear() / bright)

    def decibels(self, event: Event, moment: Moment) -> tuple[float, float, float]:
        """Returns the quality without corrections, with the watcher's, and with the true ones, as squared errors."""
        devices = moment.rig.devices
        N = np.eye(3)
        N[:2, 2] = devices.shift
        true = Drift((Moved(N, devices.projector.lamp * np.array(devices.projector.lamp_colour)),))
        wall = None if event.wall is None else event.wall(moment.time_s)
        share = np.ones((*self.room.camera.shape, 3)) if wall is None else wall.reshape(*self.room.camera.shape, -1)
        share = np.broadcast_to(share, (*self.room.camera.shape, 3))
        gains = self.view.blocks.means(share.astype(np.float32)).reshape(*self.view.shape, 3)
        drive, plain = (self.film(event, each)(moment.time_s) for each in (None if wall is None else gains, None))
        codes = encoded(true.shown(drive, self.room.regions), self.room.response)
        uncorrected = encoded(plain, self.room.response)
        added = moment.rig.ambient - self.rig.ambient
        found = _interpolated(moment.answer.ambient, self.room.camera.shape) * self.view.paint.astype(np.float64)
        lights = np.zeros_like(added), found.reshape(-1, 3), added
        target = self._mixed(self.asked.__getitem__, event.film, moment.time_s).reshape(
            -1, 3
        ) + self.room.ambient.reshape(-1, 3)
        errors = []
        for shown, light in zip((uncorrected, moment.codes, codes), lights, strict=True):
            seen = share.reshape(-1, 3) * moment.rig.seen(shown) - light - target
            errors.append(10 ** (-decibels(seen[self._inside], self.tier.white) / 10))
        return errors[0], errors[1], errors[2]

    def _mixed(self, pictures: Callable[[int], NDArray[np.float32]], film: str, time_s: float) -> FloatArray:
        one, other, share, bright = self.parts(film, time_s)
        return np.asarray(bright * ((1 - share) * pictures(one) + share * pictures(other)), np.float64)


def row(study: Study, event: Event) -> str:
    moments = list(study.run(event))
    last = [moment for moment in moments if moment.time_s > event.seconds - LAST_S]
    errors = np.array([study.decibels(event, moment) for moment in last]).mean(axis=0)
    without, with_, known = -10 * np.log10(errors)
    change = next((m for m in moments if m.time_s > CHANGE_S and m.answer.state not in ("holding", "looking")), None)
    begun = "" if change is None else f"{change.time_s - CHANGE_S:.1f}"
    answer = moments[-1].answer
    middle = last[-1].drift.projectors[0].at_corners(study.room.projectors[0])[0]
    states = sorted({m.answer.state for m in moments if m.time_s > CHANGE_S})
    found = f"{middle[0]:+.3f}, {middle[1]:+.3f}; {np.mean(answer.projectors[0].gain):.3f}"
    learned = max(float(np.any(m.row_gains != 1, axis=2).mean()) if m.row_gains is not None else 0.0 for m in moments)
    found += f"; {100 * learned:.0f} %" if event.lasts else ""
    cells = event.name, event.film, found, f"{without:.1f}", f"{with_:.1f}", f"{known:.1f}", begun, ", ".join(states)
    return f"| {' | '.join(cells)} |"


def _interpolated(field: tuple[tuple[tuple[float, ...], ...], ...], shape: tuple[int, int]) -> FloatArray:
    """Returns a field between the middles of its cells, (height, width, 3)."""
    if not field:
        return np.zeros((*shape, 3))
    cells = np.array(field)
    at = [
        np.clip((np.arange(size) + 0.5) * count / size - 0.5, 0, count - 1)
        for size, count in zip(shape, cells.shape, strict=False)
    ]
    rows, columns = np.meshgrid(*at, indexing="ij")
    return np.stack([ndimage.map_coordinates(cells[..., k], [rows, columns], order=1) for k in range(3)], axis=2)


def _compensated(tier: Tier) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Returns the drive of each picture, and the light above ambient that it should give."""
    room = tier.calibration
    objective = objective_of(tier.transport, room, DEFAULT_AIMS, tier.mixing)
    box = prepare("box", tier.transport, room.mask, objective)
    drives, asked = [], []
    for picture in _pictures(room.camera.shape):
        light = objective.bounded(tier.target(Picture("", picture).linear * tier.white).reshape(-1, 3))
        drives.append(np.clip(box.solve(light).drive, 0, 1).reshape(*room.projector.shape, 3))
        asked.append(light.reshape(*room.camera.shape, 3))
    return np.array(drives, np.float32), np.array(asked, np.float32)


def _pictures(shape: tuple[int, int]) -> Iterator[NDArray[np.uint8]]:
    """Yield photographs and frames of the shipped clip at the camera's size, without detail finer than a pixel."""
    stills = [data.astronaut(), data.coffee(), data.chelsea(), data.rocket(), data.hubble_deep_field()]
    with av.open(str(CLIP)) as clip:
        frames = [frame.to_ndarray(format="rgb24") for frame in clip.decode(video=0)]
    chosen = np.linspace(0, len(frames) - 1, CLIP_FRAMES).astype(int)
    for picture in (*stills, *(frames[i] for i in chosen)):
        small = cv2.resize(picture, shape[::-1], interpolation=cv2.INTER_AREA)
        yield np.asarray(cv2.GaussianBlur(small, (0, 0), 1.0), np.uint8)


def main() -> None:
    parser = argparse.ArgumentParser("python -m tests.studies.watching", description=__doc__)
    parser.add_argument("--room", nargs="+", choices=ROOMS, default=["wall"])
    parser.add_argument("--event", nargs="+", metavar="WORD", help="run only events whose name contains a WORD")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="keep the rooms here, for later runs")
    options = parser.parse_args()
    with threadpool_limits(limits=1), tempfile.TemporaryDirectory() as temporary:
        for name in options.room:
            folder = (options.keep or Path(temporary)) / name
            folder.mkdir(parents=True, exist_ok=True)
            study = Study(name, folder)
            print(
                f"\n{name}\n\n| event | film | found (px; light) | without | watched | true | first answer | states |"
            )
            print("|---|---|---|---|---|---|---|---|")
            for event in EVENTS:
                if not options.event or any(word in event.name for word in options.event):
                    print(row(study, event), flush=True)


if __name__ == "__main__":
    main()

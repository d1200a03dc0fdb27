"""The product next to a rig in real time: a player's window is watched by a camera with its own clock (docs/watch.md).

The camera reads the pixels that the X server shows, and exposes them in the rig's room, which changes meanwhile. Its
captures are files that the watcher reads as soon as they appear. The judge looks at the same pixels. The picture that
`verify` would give is computed after the show, for the state of the room at each judged moment.
"""

import json
import threading
import time
from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from Xlib import X
from Xlib.display import Display

from tests.desktop import ON_THE_PROCESSOR
from tests.programs import PATIENCE_S
from tests.remote import Client, show
from tests.rig import product
from tests.rig.asked import Question
from tests.rig.faults import FAULTS
from tests.rig.films import FILMS, RATE, Film
from tests.rig.judge import Judge
from tests.rig.pictures import Picture
from tests.rig.projector import Projector
from tests.rig.rays import FloatArray
from tests.rig.rig import Devices, Rig
from tests.rig.rooms import ROOMS
from tests.rig.watching import Codes, Frame, WatchCamera, WatchedRoom, crossing, door, since
from tests.screens import one_screen

LOOK_S = 0.008  # seconds between two looks at the screen
KEPT_S = 2.0  # seconds for which displayed frames are kept
STATS = "stats.json"  # of the player, at the end of a show
CAPTURES = 4  # files that stay in the folder
DRAWN = "--refine", "2", "--refine-from", "map", "--dither", "none"  # a frame does not depend on the frame before
WHITE = 0.85  # share of the automatic white: a lamp at 90 % still reaches it
NEARBY = 4  # frames around the stated position that a displayed picture may show


@dataclass(frozen=True)
class Event:
    """Something that happens to a room during a show.

    changed : function of the devices before the event and of the seconds since the event, negative before it; returns
        the devices at that time.
    person : as in WatchedRoom, for a view (height, width).
    unplugged : whether captures stop at the event; frozen: whether they repeat.
    """

    says: str
    changed: Callable[[Devices, float], Devices] = lambda devices, time_s: devices
    person: Callable[[float, tuple[int, int]], FloatArray | None] = lambda time_s, view: None
    unplugged: bool = False
    frozen: bool = False
    automatic: bool = False


def _drifting(px_per_s: float) -> Callable[[Devices, float], Devices]:
    def moved(devices: Devices, time_s: float) -> Devices:
        share = min(max(time_s, 0.0) * px_per_s, 1.0)
        return replace(devices, shift=(0.8 * share, 0.6 * share))

    return moved


EVENTS = {
    "nothing": Event("nothing changes"),
    "drift": Event("the picture drifts by one pixel in ten minutes", _drifting(1 / 600)),
    "fast-drift": Event("the same, eight times as fast", _drifting(8 / 600)),
    "half": Event("the picture jumps by half a pixel", since(0, shift=(0.4, 0.3))),
    "jump": Event("the picture jumps by three pixels", since(0, shift=(2.4, 1.8))),
    "lamp": Event("the lamp falls to 90 %", since(0, projector=Projector(lamp=0.9))),
    "door": Event("the room's light triples within two seconds", door),
    "person": Event("a person crosses the view in a minute", person=partial(crossing, light=0.1, top=0.2)),
    "unplugged": Event("the camera gives no more captures", unplugged=True),
    "frozen": Event("the camera repeats one capture", frozen=True),
    "automatic": Event("the camera's exposure follows the film", automatic=True),
    "camera": Event("the camera is pushed by a pixel", since(0, camera_moved=(4, 0))),
}


@dataclass(frozen=True)
class Moment:
    """What a judge sees at a time after the event.

    shown : PSNR of the screen.
    unwatched : PSNR of the picture that the player would show without a watcher.
    verified : PSNR of the picture after `verify` in the room's present state.
    state : the property watch-state.
    """

    time_s: float
    shown: float
    unwatched: float
    verified: float
    state: dict[str, Any]


@dataclass
class Screen:
    """The displayed frames, read from an X server by a thread."""

    display: str
    size: tuple[int, int]  # (width, height)
    frames: list[Frame] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._over, self._lock = threading.Event(), threading.Lock()
        self._thread = threading.Thread(target=self._look, daemon=True)
        self._thread.start()

    def since(self, time_s: float) -> list[Frame]:
        """Return the frames on the screen from `time_s` on."""
        with self._lock:
            first = bisect_right([frame.time_s for frame in self.frames], time_s) - 1
            return self.frames[max(first, 0) :]

    def close(self) -> None:
        self._over.set()
        self._thread.join()

    def _look(self) -> None:
        connection = Display(self.display)
        root = connection.screen().root
        while not self._over.wait(LOOK_S):
            now_s = time.monotonic()
            packed = np.frombuffer(root.get_image(0, 0, *self.size, X.ZPixmap, 0xFFFFFFFF).data, np.uint8)
            codes = packed.reshape(*self.size[::-1], 4)[..., 2::-1]
            if not self.frames or not np.array_equal(codes, self.frames[-1].codes):
                with self._lock:
                    self.frames.append(Frame(now_s, codes.copy()))
                    while len(self.frames) > 1 and self.frames[1].time_s < now_s - KEPT_S:
                        del self.frames[0]
        connection.close()


class LiveCamera:
    """A thread that photographs the screen in the room, and leaves the captures in a folder."""

    def __init__(self, room: WatchedRoom, camera: WatchCamera, event: Event, screen: Screen, folder: Path) -> None:
        self._room, self._camera, self._event, self._screen, self._folder = room, camera, event, screen, folder
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self.began_s = float("inf")  # start of the event, time.monotonic
        self._thread.start()

    def close(self) -> None:
        self._over.set()
        self._thread.join()

    def _run(self) -> None:
        content, number = b"", 0
        due_s = time.monotonic() + 0.5
        while not self._over.wait(max(due_s - time.monotonic(), 0.0)):
            camera, happens = self._camera, due_s >= self.began_s
            frames = self._screen.since(due_s - camera.exposure_s - camera.rolling_s)
            if frames and not (happens and self._event.unplugged):
                arrival_s, codes = self._room.capture(due_s, frames)
                if not (happens and self._event.frozen and content):
                    content = cv2.imencode(".png", codes[..., ::-1], (cv2.IMWRITE_PNG_COMPRESSION, 0))[1].tobytes()
                self._over.wait(max(arrival_s - time.monotonic(), 0.0))
                self._write(number, content)
                number += 1
            due_s = max(due_s + camera.period_s, time.monotonic() - camera.latency_s)

    def _write(self, number: int, content: bytes) -> None:
        begun = self._folder / f".{number:07}.png"
        begun.write_bytes(content)
        begun.rename(self._folder / f"{number:07}.png")
        with suppress(FileNotFoundError):
            (self._folder / f"{number - CAPTURES:07}.png").unlink()


@dataclass(frozen=True)
class Seen:
    """A displayed picture to judge: its codes, the film's position, and the state of the watcher."""

    time_s: float
    codes: Codes
    position_s: float
    state: dict[str, Any]


@dataclass(frozen=True)
class Show:
    """A show that has ended, in a room that has changed.

    began_s : start of the event, time.monotonic.
    """

    place: Path
    rig: Rig
    watched: WatchedRoom
    film: Film
    white: float
    began_s: float
    seen: tuple[Seen, ...]


def live(
    folder: Path,
    room: str,
    film_name: str,
    event_name: str,
    *,
    scale: float,
    warm_s: float,
    after_s: Sequence[float],
    camera: WatchCamera,
    watch: bool = True,
) -> Show:
    """Play a film in a room, let an event happen after `warm_s`, and read the screen at times after the event.

    watch : whether the player has a watcher. The camera takes captures in any case.
    """
    event, made = EVENTS[event_name], ROOMS[room](scale)
    rig = Rig(made, FAULTS["known"].devices)
    place = folder / f"{room}-{scale:g}"
    if not (place / "room").exists():
        place.mkdir(parents=True, exist_ok=True)
        product.acquire(rig, place, "--response", str(_response(rig, place)))
        product.build(place)
    product.forget(place)
    film = FILMS[film_name]((rig.camera[1], rig.camera[1] * 9 // 16 // 2 * 2))
    path = film.write(place / f"{film_name}.mkv")
    white = WHITE * product.show(place, film.still(place / "still.png", 0)).white
    origin = time.monotonic() + 1e6  # far in the future until the event happens
    began = [origin]

    def devices(time_s: float) -> Devices:
        return event.changed(rig.devices, time_s - began[0])

    watched = WatchedRoom(rig, camera, devices, lambda time_s: event.person(time_s - began[0], rig.camera))
    soon_s = np.arange(0, 2, 0.1)
    for later_s in (*soon_s, *np.arange(2, max(after_s) + 1, 1.0)):  # a changed room takes seconds to compute
        watched.rig_at(origin + later_s).seen_by_camera(np.zeros((*rig.raster, 3), np.uint8))
    captures = place / "captures"
    captures.mkdir(exist_ok=True)
    (place / "show.socket").unlink(missing_ok=True)  # left by a player that was killed
    seen = tuple(_played(place, path, rig, watched, event, camera, began, white, warm_s, after_s, watch))
    return Show(place, rig, watched, film, white, began[0], seen)


def _response(rig: Rig, place: Path) -> Path:
    return product.write_response(place / "response.toml", rig.devices.projector.response_table())


def _played(
    place: Path,
    path: Path,
    rig: Rig,
    watched: WatchedRoom,
    event: Event,
    camera: WatchCamera,
    began: list[float],
    white: float,
    warm_s: float,
    after_s: Sequence[float],
    watch: bool,
) -> Iterator[Seen]:
    """Play, and yield what the screen shows at each of the times."""
    height, width = rig.raster
    folder = place / "captures"
    words = "--loop", "--osd", "off", "--white", white, *DRAWN, "--fullscreen"
    words = *words, "--heartbeat", place / "heartbeat", "--stats", place / STATS
    words = *words, *(("--watch", f"folder:{folder}") if watch else ())
    with (
        one_screen(place, (width, height)) as display,
        closing(Screen(display, (width, height))) as screen,
        closing(LiveCamera(watched, camera, event, screen, folder)) as eye,
        show(display, place, place / "room", path, *words, how=ON_THE_PROCESSOR) as (player, client),
    ):
        time.sleep(warm_s)
        began[0] = eye.began_s = time.monotonic()
        if event.automatic:
            watched.camera = replace(camera, automatic=True)
        for later_s in after_s:
            time.sleep(max(began[0] + later_s - time.monotonic(), 0.0))
            before_s = client.get("time-pos")
            frame = screen.since(time.monotonic())[-1]
            yield Seen(time.monotonic() - began[0], frame.codes, before_s, _state(client))
        client.ask("quit")
        player.wait(PATIENCE_S)


def _state(client: Client) -> dict[str, Any]:
    return dict(client.get("watch-state") or {})


@dataclass(frozen=True)
class Unwatched:
    """A seen picture, and the same film frame as the player shows it without a watcher.

    still : the film frame as a file.
    """

    seen: Seen
    judge: Judge
    question: Question
    still: Path
    codes: Codes

    def psnr(self, codes: Codes) -> float:
        return self.judge.figures(self.question, codes).psnr


def words_of(show: Show) -> tuple[str, ...]:
    """Returns the options with which the show was played."""
    return "--white", str(show.white), *DRAWN


def unwatched(show: Show) -> Iterator[Unwatched]:
    """Yield each seen picture, next to the same film frame without a watcher, in the room of that time."""
    for each in show.seen:
        judge = Judge(show.watched.rig_at(show.began_s + each.time_s))
        frame = _frame(judge.rig, show.film, each, show.white)
        still = show.film.still(show.place / "judged.png", frame)
        picture = Picture(f"{show.film.name} {frame}", show.film.frames[frame])
        question = judge.asks(picture, show.white, product.show_plain(show.place, still).codes)
        yield Unwatched(each, judge, question, still, product.show(show.place, still, *words_of(show)).codes)


def judged(show: Show) -> Iterator[Moment]:
    """Yield the figures of each seen picture, next to the same film frame without a watcher and after a check."""
    for number, each in enumerate(unwatched(show), 1):
        if each.judge.rig.devices.camera_moved == (0, 0):  # verify refuses a camera that has moved
            product.check(each.judge.rig, show.place, seed=number)
        verified = product.show(show.place, each.still, *words_of(show)).codes
        product.forget(show.place)
        shown, without, after = (each.psnr(codes) for codes in (each.seen.codes, each.codes, verified))
        yield Moment(each.seen.time_s, shown, without, after, each.seen.state)


def _frame(rig: Rig, film: Film, seen: Seen, white: float) -> int:
    """Return the frame that the audience recognises in displayed codes, near the stated position."""
    light = rig.seen(seen.codes).reshape(*rig.camera, 3) - rig.ambient.reshape(*rig.camera, 3)
    middle, count = round(seen.position_s * RATE), len(film.frames)
    near = [index % count for index in range(middle - NEARBY, middle + NEARBY + 1)]

    def misfit(index: int) -> float:
        placed, inside = Picture("", film.frames[index]).placed(rig.camera)
        return float(np.mean((light - white * placed)[inside] ** 2))

    return min(near, key=misfit)


STATE = "state", "reason", "moved_px", "gain", "added_light"  # keys of watch-state in the table
QUALITIES = "without, dB", "after verify, dB", "watched, dB"
HEADS = "event", "film", "time", *QUALITIES, *(key.replace("_", " ") for key in STATE)


def frame_times(show: Show) -> str:
    """Returns the frames and their times, from the player's statistics."""
    stats = json.loads((show.place / STATS).read_text())
    counted = f"{stats['frames']} frames shown, {stats['dropped']} dropped"
    times = (
        f"{what} {stats[name]['median']:.1f} ms (median), {stats[name]['p95']:.1f} ms (95 % of the frames)"
        for what, name in (("drawing", "gpu_ms"), ("lateness", "late_ms"))
    )
    return "; ".join((counted, *times))


def row_of(event: str, film: str, moment: Moment) -> str:
    """Return a row of the table below `HEADS`, in Markdown."""
    state = moment.state
    qualities = moment.unwatched, moment.verified, moment.shown
    cells = event, film, f"{moment.time_s:.0f} s", *(f"{each:.1f}" for each in qualities)
    cells = *cells, *(str(state.get(key, "")) for key in STATE)
    return f"| {' | '.join(cells)} |"

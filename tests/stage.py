"""Session with fake clock, reader, renderer and display."""

from collections.abc import Callable
from dataclasses import dataclass, field, fields
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from counterlight.errors import InputError
from counterlight.media.medium import Border, Medium
from counterlight.overlay.osd import Page, Pointer
from counterlight.overlay.outline import Outline, moved, outline_of
from counterlight.pipeline.adjustments import Adjustments
from counterlight.pipeline.correction import Correction
from counterlight.pipeline.device import PathReport
from counterlight.pipeline.placement import Corners
from counterlight.pipeline.refinement import Certificate
from counterlight.pipeline.shortfall import Shortfall, Snapshot
from counterlight.show.beginning import Playing, Showing, Sound
from counterlight.show.governor import Governor
from counterlight.show.playlist import Playlist, listed
from counterlight.show.registry import Commands
from counterlight.show.session import Session
from counterlight.show.show import Show
from counterlight.viewpoints import Viewpoint

MEASURED = PathReport("fragment", 16, None, {"fragment": 12.5, "compute": 25.0})
GOVERNED = "refine", "budget", "within", "offers"
SQUARE: Corners = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0))


@dataclass
class Clock:
    now: float = 100.0

    def __call__(self) -> float:
        return self.now


@dataclass
class Reader:
    """Fake reader with 25 frames per second, all decoded at once; loops if asked."""

    path: str = "clip"
    count: int = 50
    still: bool = False
    loop: bool = False
    rate: float = 25.0
    fails_at: int | None = None
    position: int = 0
    released: list[int] = field(default_factory=list)
    news: list[str] = field(default_factory=list)
    closed: bool = False
    opens_s: float = 0.0  # seconds that opening takes
    error: str | None = None  # error that is raised after the frames

    def __post_init__(self) -> None:
        self.info: Any = SimpleNamespace(
            path=Path(self.path),
            format=SimpleNamespace(width=4, height=3, path=self.path),
            frames_per_second=self.rate,
            still=self.still,
            live=False,
            sound=False,
            duration_s=None if self.still else self.count / 25,
            codec="none",
        )
        self.clock: Callable[[], float] = float  # always 0.0; the stage replaces it
        self.opened_at = 0.0

    @property
    def ended(self) -> bool:
        return self.position >= self.count and not (self.loop and not self.still)

    def ready(self) -> bool:
        if self.clock() >= self.opened_at and self.error is not None:
            raise InputError(self.error)
        return self.clock() >= self.opened_at

    def poll(self) -> Any:
        if self.ended:
            return None
        if self.position == self.fails_at:
            raise InputError(f"{self.path}: broken")
        self.position += 1
        index = self.position - 1
        return SimpleNamespace(
            index=index, time_s=index / 25, duration_s=0.04, decode_s=0.001, skipped=0, format=self.info.format
        )

    def skip(self, time_s: float) -> None: ...

    def release(self, frame: Any) -> None:
        self.released.append(frame.index)

    def seek(self, time_s: float) -> None:
        self.position = int(time_s * 25 + 1e-6)

    def notices(self) -> list[str]:
        fresh, self.news = self.news, []
        return fresh

    def close(self) -> None:
        self.closed = True


@dataclass
class Screen:
    """Fake window and renderer that records the pictures it should show."""

    closed: bool = False
    fullscreen: bool = False
    monitor: str = "A"
    bits: int = 8
    size: tuple[int, int] = (720, 1280)
    title: str = ""
    uploaded: list[int] = field(default_factory=list)
    shown: list[tuple[str, bool, bool]] = field(default_factory=list)
    pages: list[Page | None] = field(default_factory=list)
    state: tuple[str, bool] = ("", False)
    steps: list[int] = field(default_factory=list)
    starts: list[str] = field(default_factory=list)
    snapshots: int = 0
    stage_s: dict[str, float] = field(default_factory=dict)
    adjusted: list[Adjustments] = field(default_factory=list)
    news: list[str] = field(default_factory=list)
    certified: int = 0
    identified: int = 0
    opened: int = 0
    prepared: list[str] = field(default_factory=list)
    fades: list[tuple[float, float]] = field(default_factory=list)
    uploaded_before: list[int] = field(default_factory=list)
    corrections: list[Correction] = field(default_factory=list)
    released: bool = False
    path: PathReport = MEASURED

    def prepare(self, pixels: Any, *, crossfade: bool = False) -> None:
        self.prepared.append(pixels.path)

    def fade(self, level: float, weight: float = 0.0) -> None:
        self.fades.append((level, weight))

    def correct(self, correction: Correction) -> None:
        self.corrections.append(correction)

    def copy_shown(self, factor: int, grid: tuple[int, int]) -> Any:
        """Return copies of a raster of 200x150, whose values are the number of the frame."""
        shape, number = (150 // factor, 200 // factor, 3), self.uploaded[-1]
        return SimpleNamespace(
            grid=lambda: np.full((*grid, 3), number, np.float32), picture=lambda: np.full(shape, number, np.float16)
        )

    def upload_before(self, frame: Any) -> None:
        self.uploaded_before.append(frame.index)

    def end_crossfade(self) -> None: ...

    def open(self, pixels: Any, *, crossfade: bool = False) -> None:
        self.opened += 1

    def adjust(self, adjustments: Adjustments) -> None:
        self.adjusted.append(adjustments)

    def upload(self, frame: Any) -> None:
        self.uploaded.append(frame.index)

    def start_from(self, start: str, bare: str = "map") -> None:
        self.starts.append(start)

    def snapshot(self) -> Snapshot:
        self.snapshots += 1
        nothing = np.zeros((1, 1, 3), np.float32)
        return Snapshot(self.certificate(), nothing, nothing, nothing, nothing, self.steps[-1], self.steps[-1])

    def render(self, view: str, *, compensate: bool, frame: int = 0, steps: int = 0, timed: bool = False) -> None:
        self.state = view, compensate
        self.steps.append(steps)

    def certificate(self) -> Certificate:
        self.certified += 1
        return Certificate(np.ones(3), np.full(3, 0.01))

    def finish(self) -> None: ...

    def release(self) -> None:
        self.released = True

    def poll(self, timeout_s: float) -> list[str]:
        return []

    def pointers(self) -> list[Pointer]:
        return []

    def notices(self) -> list[str]:
        fresh, self.news = self.news, []
        return fresh

    def present(self, page: Page | None, *, black: bool) -> None:
        self.shown.append((*self.state, black))
        self.pages.append(page)

    def set_fullscreen(self, on: bool) -> None:
        self.fullscreen = on

    def set_title(self, title: str) -> None:
        self.title = title

    def move_to(self, monitor: str) -> None:
        if monitor not in "AB":
            raise InputError(f"monitor {monitor!r}: not there")
        self.monitor = monitor

    def identify(self) -> None:
        self.identified += 1


class Stage:
    """Show with a session of fakes, including the opener and the room."""

    def __init__(self, *readers: Reader, loop_list: bool = False, **options: Any) -> None:
        self.readers = {reader.path: reader for reader in readers or (Reader(),)}
        self.begun: list[str] = []
        self.reader = next(iter(self.readers.values()))
        self.clock, self.screen = Clock(), Screen()
        self.saved: list[Corners | None] = []
        self.fitted: dict[str, Corners] = {}  # corners by the path of a reader's medium
        self.below: Callable[[int], float] = lambda steps: 1 / (1 + steps)  # dB below the optimum
        self.fresh: list[Any] = []
        self.refinable, self.drifts = True, False
        self.drifted: dict[str, Any] | None = None
        self.expected: str | None = None
        self.outside: Callable[[Viewpoint], str | None] = lambda viewpoint: None
        watching = options.pop("watching", None)  # makes the watching for a session
        self.read_last: Any = None
        told = {name: options.pop(name) for name in ("bindings", "remotes", "heartbeat", "checks") if name in options}
        governed = {name: options.pop(name) for name in GOVERNED if name in options}
        groups: dict[str, Any] = {"playing": Playing, "showing": Showing}
        grouped = {
            group: made(**{each.name: options.pop(each.name) for each in fields(made) if each.name in options})
            for group, made in groups.items()
        }
        self.session = Session(
            Playlist(list(self.readers), loop=loop_list),
            self,
            self.screen,  # type: ignore[arg-type]
            self.screen,
            self,  # type: ignore[arg-type]
            clock=self.clock,
            governor=Governor(options.pop("usual", 0), **governed),
            sound=Sound(options.pop("audio", None), options.pop("silence", None)),
            **grouped,
            **options,
        )
        self.show = Show(self.session, watching=watching and watching(self), **told)

    @property
    def commands(self) -> Commands:
        return self.show.commands

    def medium(self, name: str) -> Medium:
        return Medium(name)

    def find(self, medium: Medium) -> list[Medium]:
        found = listed(medium, Border())
        if found == [medium] and medium.name not in self.readers:
            raise InputError(f"{medium}: no such file")
        return found

    def begin(self, medium: Medium, *, loop: bool) -> Any:
        self.begun.append(medium.name)
        if medium.name not in self.readers:
            raise InputError(f"{medium}: no such file")
        reader = self.readers[medium.name]
        reader.position, reader.closed, reader.loop = 0, False, loop
        reader.opened_at = self.clock() + reader.opens_s
        reader.clock = self.clock
        return reader

    def reload(self) -> Any:
        fresh = self.fresh.pop(0)
        if isinstance(fresh, Exception):
            raise fresh
        return fresh

    def stand(self, viewpoint: Viewpoint) -> str | None:
        return self.outside(viewpoint)

    def unlit(self, pixels: Any, corners: Corners | None) -> None:
        """The light of this fake reaches every picture."""

    def fit(self, pixels: Any) -> Corners:
        return self.fitted.get(pixels.path, SQUARE)

    def keep(self, corners: Corners | None) -> None:
        self.saved.append(corners)

    def appraise(self, snapshot: Snapshot) -> Shortfall:
        return Shortfall(self.below(snapshot.steps), self.below(snapshot.steps) / 2, snapshot.steps, 4, 4)

    def psnr(self, certificate: Certificate) -> float:
        return 40.0

    def outline(self, corners: Corners, corner: int | None, view: str) -> Outline:
        drawn = outline_of(corners, corner, (3, 4))
        return moved(drawn, lambda points: points / 2) if view == "projector" else drawn

    def pointed_at(self, points: Any, view: str) -> Any:
        return points * 2 if view == "projector" else points

    def advance(self, seconds: float, step: float = 0.01) -> None:
        end = self.clock.now + seconds
        while self.clock.now < end - 1e-9:
            self.clock.now += step
            self.show.step()

    def press(self, *keys: str) -> str:
        """Press keys, draw, and return the message on the screen."""
        for key in keys:
            self.show.press(key)
            self.show.step()
        return self.session.message.text

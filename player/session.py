"""Playback in a window: which frame is due, what a key does. Knows no OpenGL; a display and a clock are handed in."""

import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Protocol

from player.errors import InputError
from player.files import replacing_file
from player.output import write_picture
from player.refinement import MOST_STEPS, Certificate, StepBudget
from player.renderer import VIEWS, Renderer
from player.stats import Stats
from player.video import Frame, MediaReader

SEEKS_S = {"left": -5.0, "right": 5.0, "down": -60.0, "up": 60.0}
STATS_INTERVAL_S = 0.5
LONGEST_WAIT_S = 0.05  # between looks at the decoder; keys wake the window at once


class Display(Protocol):
    """A window that shows what the renderer has rendered."""

    @property
    def closed(self) -> bool: ...

    def poll(self, timeout_s: float) -> list[str]:
        """Names of the keys pressed since the last call, waiting at most `timeout_s` for one."""

    def present(self, lines: list[str], *, black: bool) -> None:
        """Show the rendered view with lines of text over it, or black."""

    def toggle_fullscreen(self) -> None: ...


class Session:
    """Plays one medium through a renderer into a display.

    clock : seconds, monotonic. A frame is due when the clock has reached its time; frames overtaken are dropped.
    steps : of refinement.  budget : finds their number instead, until a key sets it.
    """

    def __init__(
        self,
        reader: MediaReader,
        renderer: Renderer,
        display: Display,
        *,
        view: str = "projector",
        compensate: bool = True,
        steps: int = 0,
        budget: StepBudget | None = None,
        screenshots: Path = Path(),
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.stats = Stats()
        self.view, self.compensate = view, compensate
        self.paused = self.blackout = self.show_stats = self.done = False
        self.steps, self._budget = steps, budget
        self._reader, self._renderer, self._display = reader, renderer, display
        self._screenshots, self._clock = screenshots, clock
        self._pending: Frame | None = None
        self._position_s = self._shown_until_s = 0.0
        self._started_at: float | None = None  # clock time of media time 0; None until the next frame arrives
        self._dirty = self._rendered = False
        self._message = ""
        self._certificate: Certificate | None = None
        self._certified_at = float("-inf")
        self._draws = self._steps_made = 0
        self._keys = self._bindings()

    def run(self, limit: int | None = None) -> Stats:
        """Play until the medium ends, the window closes, `q`, or `limit` frames have been shown."""
        while not (self.done or self._display.closed):
            for key in self._display.poll(self._wait_s()):
                self.handle(key)
            self.step()
            if limit is not None and self.stats.frames >= limit:
                break
        if self._draws:
            self._certify()
            certified = {} if self._certificate is None else self._certificate.to_dict()
            self.stats.facts["refinement"] = {"steps": round(self._steps_made / self._draws, 1), **certified}
        return self.stats

    def step(self) -> None:
        """Take the frame that is due, if any, and show it; redraw if a key changed something."""
        for notice in self._reader.notices():
            print(notice, file=sys.stderr)
            self.stats.notices.append(notice)
        frame = None if self.paused and self._rendered else self._due_frame()
        if frame is not None:
            start = time.perf_counter()
            self._renderer.upload(frame)
            self._reader.release(frame)
            self.stats.add("decode", frame.decode_s)
            self.stats.add("upload", time.perf_counter() - start)
            self.stats.frames += 1
            self._position_s, self._shown_until_s = frame.time_s, frame.time_s + frame.duration_s
            self._rendered = self._dirty = True
        elif self._reader.ended and self._pending is None and not self._reader.info.still:
            self.done = self._started_at is None or self._media_time() >= self._shown_until_s
        if self._dirty and self._rendered:
            self._draw()

    def handle(self, key: str) -> None:
        """Do what a key stands for; unknown keys do nothing."""
        action = self._keys.get(key)
        if action is not None:
            action()
            self._dirty = True

    def _bindings(self) -> dict[str, Callable[[], None]]:
        return {
            "redraw": lambda: None,
            "space": self._toggle_pause,
            "p": self._toggle_pause,
            "c": lambda: self._flip("compensate"),
            "i": lambda: self._flip("show_stats"),
            "b": lambda: self._flip("blackout"),
            "[": lambda: self._set_steps(self.steps // 2),
            "]": lambda: self._set_steps(min(max(2 * self.steps, 1), MOST_STEPS)),
            "v": self._next_view,
            "f": self._toggle_fullscreen,
            "s": self._screenshot,
            "q": lambda: self._flip("done"),
            "escape": lambda: self._flip("done"),
            **{key: partial(self._seek, step) for key, step in SEEKS_S.items()},
        }

    def _flip(self, name: str) -> None:
        setattr(self, name, not getattr(self, name))

    def _set_steps(self, steps: int) -> None:
        self.steps, self._budget = steps, None
        self._message = f"{steps} steps of refinement"

    def _toggle_pause(self) -> None:
        self.paused = not self.paused
        if self._started_at is not None:
            # Playing, it is the clock time of media time 0; paused, the media time: each is the clock less the other.
            self._started_at = self._clock() - self._started_at

    def _seek(self, step: float) -> None:
        if self._reader.info.still:
            return
        self._drop_pending()
        if self._reader.info.duration_s:
            self._position_s %= self._reader.info.duration_s  # time goes on when a medium is looped
        self._position_s = max(0.0, self._position_s + step)
        self._reader.seek(self._position_s)
        self._started_at, self._rendered = None, False

    def _toggle_fullscreen(self) -> None:
        try:
            self._display.toggle_fullscreen()
        except InputError as error:  # the monitor has gone: the show goes on in its window
            self._message = str(error)
            print(error, file=sys.stderr)

    def _next_view(self) -> None:
        self.view = VIEWS[(VIEWS.index(self.view) + 1) % len(VIEWS)]

    def _screenshot(self) -> None:
        if not self._rendered:
            return
        path = self._screenshots / f"counterlight-{time.strftime('%Y%m%d-%H%M%S')}-{self.stats.frames:06d}.png"
        try:
            with replacing_file(path) as temporary:
                write_picture(temporary, self._renderer)
            self._message = f"saved {path}"
        except InputError as error:
            self._message = str(error)
        print(self._message)

    def _due_frame(self) -> Frame | None:
        """The newest frame whose time has come; older ones that were not shown in time are dropped and counted."""
        due: Frame | None = None
        while True:
            self._pending = self._pending or self._reader.poll()
            if self._pending is None:
                break
            if self._started_at is None:
                self._started_at = self._anchor(self._pending.time_s)
            if self._pending.time_s > self._media_time():
                break
            if due is not None:
                self._reader.release(due)
                self.stats.dropped += 1
            due, self._pending = self._pending, None
        return due

    def _anchor(self, time_s: float) -> float:
        return time_s if self.paused else self._clock() - time_s

    def _media_time(self) -> float:
        assert self._started_at is not None
        return self._started_at if self.paused else self._clock() - self._started_at

    def _wait_s(self) -> float:
        if self._dirty:
            return 0.0
        if self._pending is None or self._started_at is None or self.paused:
            return LONGEST_WAIT_S if self._rendered else 0.001
        return min(max(self._pending.time_s - self._media_time(), 0.0), LONGEST_WAIT_S)

    def _drop_pending(self) -> None:
        if self._pending is not None:
            self._reader.release(self._pending)
            self._pending = None

    def _draw(self) -> None:
        start = time.perf_counter()
        if self._budget is not None:
            self.steps = self._budget.steps
        self._renderer.render(self.view, compensate=self.compensate, frame=self.stats.frames, steps=self.steps)
        self._renderer.finish()
        seconds = time.perf_counter() - start
        self.stats.add("gpu", seconds)
        if self._budget is not None:
            self._budget.took(seconds)
        self._draws += 1
        self._steps_made += self.steps
        if self.show_stats and self._clock() - self._certified_at >= STATS_INTERVAL_S:
            self._certify()
        self._display.present(self._lines() if self.show_stats else [], black=self.blackout)
        self._dirty = False

    def _certify(self) -> None:
        self._certificate, self._certified_at = self._renderer.certificate(), self._clock()

    def _lines(self) -> list[str]:
        info, stats = self._reader.info, self.stats
        return [
            f"{Path(info.path).name}  {info.format.width}x{info.format.height}  {info.frames_per_second:.3g} fps",
            f"{self._position_s:.2f} s  view {self.view}  compensation {'on' if self.compensate else 'off'}",
            f"frames {stats.frames}  dropped {stats.dropped}",
            *(f"{stage} {stats.median_ms(stage):.1f} ms" for stage in ("decode", "upload", "gpu")),
            *([f"refinement {self.steps} steps, {self._certificate}"] if self._certificate is not None else []),
            *([self._message] if self._message else []),
        ]

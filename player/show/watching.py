"""Keeps a room calibrated during the show: sends displayed frames to the watcher, and applies its corrections.

The watcher (unattended/watcher.py) compares displayed frames with photographs of the room. The frame loop never waits
for the watcher. After any fault, the last correction stays.
"""

import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from counterlight.calibration import Device
from counterlight.errors import InputError
from counterlight.overlay.osd import Page
from counterlight.pipeline.correction import NO_LIGHT, Correction, blocks_of
from counterlight.pipeline.drift import Moved
from counterlight.pipeline.shown_copies import ShownCopies
from counterlight.show.registry import CommandError, Property, named
from counterlight.show.session import Session
from counterlight.unattended.watch_link import (
    GAINS,
    GRID,
    PAINT,
    ROW_GAINS,
    Answer,
    Light,
    Picture,
    Projected,
    Situation,
    Start,
    farthest_px,
)
from counterlight.unattended.watcher import Watcher

BURST, PICTURE_EVERY_S = 4, 0.2  # most pictures of consecutive frames, and the mean time between two pictures
SLOWEST_S = 0.1  # longest time that a frame is expected to stand
STANDS_S = 0.2  # time on the screen after which a frame's picture is sent even between bursts
SETTLED_S = 0.004  # time for a GPU to draw the copies, so that reading them does not wait
KEPT_EVERY_S, MOST_KEPT = 20.0, 2160  # time between rows of the history, and most rows: twelve hours
GAIN = 0.5, 1.5  # limits of a correction's gain, the factor of the light
MOST_CELLS = 12, 16
FAULTS = "no camera", "not the room", "camera moved", "camera changed", "acquire again"  # states that are faults
AGAIN_S = 600.0  # shortest time until the same state is reported again
ABSENT = "no camera watches the room; start with --watch CAMERA"


class Watching:
    """The player's connection to the watcher. `poll` runs once per loop.

    start : the first message to each watcher.
    dims : whether white follows the lamps, because the user has not given a white level.
    """

    def __init__(self, session: Session, watcher: Watcher, start: Start, *, dims: bool) -> None:
        self._session, self._watcher, self._start, self._dims = session, watcher, start, dims
        self._renderer = session.renderer
        self._paint: NDArray[np.floating] | None = None
        self._applied: tuple[object, ...] = (), (), 0
        self._frozen = self._covered = self._checking = False
        self._situation = Situation()
        self._shown: _Shown | None = None
        self._bursts = Bursts()
        self._answer, self._figures = Answer("starting"), dict[str, float]()
        self._told: dict[str, float] = {}
        self._history: deque[list[float]] = deque(maxlen=MOST_KEPT)
        self._kept_s = float("-inf")
        session.on_present = self.present
        self._tell()

    @property
    def frozen(self) -> bool:
        return self._frozen

    def freeze(self, on: bool) -> None:
        """Keep the correction as it is, or let it change again."""
        self._frozen = on
        self._situate()

    def history(self) -> list[list[float]]:
        """Return rows for JSON: Unix time, largest move in pixels, least gain, added light / white, confidence."""
        return list(self._history)

    def present(self, page: Page | None, dark: bool) -> None:
        """Take note of what the display has just presented.

        page : text over the picture.
        dark : whether all is black.
        """
        session, now_s = self._session, self._session.clock()
        self._follow_renderer()
        self._send_shown()
        self._shown = None
        self._covered = not dark and (page is not None or session.rendered_view != "projector")
        self._situate()
        if dark:
            self._watcher.send(Light(now_s, np.zeros((*GRID, 3), np.float32)))
        elif not self._covered:
            copies = session.renderer.copy_shown(self._start.factor, GRID)
            self._shown = _Shown(now_s, copies, self._bursts.takes(now_s))

    def poll(self, *, checking: bool) -> None:
        """Serve the watcher. Never waits.

        checking : whether a check of the room uses the camera.
        """
        self._checking = checking
        self._follow_renderer()
        if checking:
            self._watcher.rest()
        elif self._watcher.due():
            self._begin()
        if self._shown is not None:
            stands_s = self._session.clock() - self._shown.at_s
            self._shown.wanted |= stands_s >= STANDS_S
            if stands_s >= SETTLED_S:
                self._send_shown()
        answer = self._watcher.poll()
        if answer is not None:
            self._take(answer)
        self._tell()

    def close(self) -> None:
        """End the watcher."""
        self._session.on_present = None
        self._watcher.close()

    def _begin(self) -> None:
        self._answer, self._figures, self._paint = Answer("starting"), {}, None
        self._watcher.begin(self._start)

    def _send_again(self) -> None:
        """Send the present state and all further frames to a watcher that has just started."""
        self._watcher.send(self._situation)
        if self._shown is not None:
            self._shown.lit = self._shown.pictured = False

    def _follow_renderer(self) -> None:
        """Start again after a reload, because the room may have been calibrated again."""
        if self._session.renderer is not self._renderer:
            self._renderer, self._shown, self._applied = self._session.renderer, None, ((), (), 0)
            (Path(self._start.folder) / GAINS).unlink(missing_ok=True)
            self._watcher.rest()

    def _situate(self) -> None:
        situation = Situation(self._frozen or self._covered)
        if situation != self._situation:
            self._situation = situation
            self._watcher.send(situation)

    def _send_shown(self) -> None:
        """Send the light and, if it is wanted, the picture of the displayed frame."""
        shown = self._shown
        if shown is None or not self._watcher.running:
            return
        if not shown.lit:
            shown.lit = True
            self._watcher.send(Light(shown.at_s, shown.copies.grid()))
        if shown.wanted and not shown.pictured:
            shown.pictured = True
            self._watcher.send(Picture(shown.at_s, shown.copies.picture()))

    def _take(self, answer: Answer) -> None:
        """Apply an answer, and report a state that is a fault."""
        try:
            found = self._found(answer)
            self._apply(answer, found)
        except (InputError, OSError, TypeError, ValueError) as error:
            self._watcher.refuse(f"its answer cannot be used ({error})")
            return
        if self._answer.state == "starting" != answer.state:
            self._send_again()
        self._answer, now_s = answer, self._session.clock()
        self._bursts.exposes = answer.exposes
        if answer.state in FAULTS and now_s - self._told.get(answer.state, float("-inf")) >= AGAIN_S:
            self._told[answer.state] = now_s
            self._session.notice(f"watch: {answer.state}: {answer.reason}")
        if found and now_s - self._kept_s >= KEPT_EVERY_S:
            self._kept_s = now_s
            figures = (self._figures[name] for name in ("moved_px", "gain", "added_light"))
            self._history.append([round(time.time()), *figures, round(answer.confidence, 3)])

    def _found(self, answer: Answer) -> tuple[Moved, ...]:
        """Return the projectors of an answer. Raises InputError or ValueError for numbers beyond the limits."""
        devices = self._session.room.read_last.calibration.projectors
        if not answer.projectors:
            return ()
        if len(answer.projectors) != len(devices):
            raise ValueError(f"{len(answer.projectors)} projectors, expected {len(devices)}")
        return tuple(moved_of(each, device) for each, device in zip(answer.projectors, devices, strict=True))

    def _apply(self, answer: Answer, projectors: tuple[Moved, ...]) -> None:
        found, room, session = (
            (answer.projectors, answer.ambient, answer.row_gains),
            self._session.room.read_last,
            self._session,
        )
        if not projectors or found == self._applied or self._frozen:
            return
        ambient = _field(answer)
        if answer.ambient and self._paint is None:
            self._paint = _read_paint(Path(self._start.folder) / PAINT, room.calibration.camera)
        gains = _read_gains(Path(self._start.folder) / GAINS, room.calibration.camera) if answer.row_gains else None
        gain = float(min(each.gain.min() for each in projectors))
        calibrated = 1.0 if room.drift is None else room.drift.dimming
        white = gain / calibrated if self._dims else 1.0
        session.renderer.correct(Correction(projectors, ambient, self._paint, white, gains))
        self._applied = found
        moves = (each.at_corners(device) for each, device in zip(projectors, room.calibration.projectors, strict=True))
        self._figures = {
            "moved_px": round(max(float(np.abs(each).max()) for each in moves), 3),
            "gain": round(gain, 4),
            "added_light": round(float(ambient.mean()) / room.white, 4),
            "learned": 0.0 if gains is None else round(float(np.any(gains != 1, axis=2).mean()), 4),
        }
        playback = session.playback
        if playback is None or playback.paused or playback.reader.info.still:  # no frame comes soon
            session.changed()

    def _tell(self) -> None:
        """Update the fact `watch`, which the property, the heartbeat and the statistics share."""
        answer, state, reason = self._answer, self._answer.state, self._answer.reason
        if self._checking:
            state, reason = "starting", "a check of the room uses the camera"
        elif not self._watcher.running:
            state, reason = "starting", self._watcher.fault
        elif self._frozen:
            state, reason = "frozen", "by the user"
        elif self._covered:
            state, reason = "holding", "text covers the picture, or another view is shown"
        unsure_px = [each.unsure_px for each in answer.projectors if each.unsure_px is not None]  # None: unknown
        self._session.stats.facts["watch"] = {
            "state": state,
            "reason": reason,
            "confidence": answer.confidence,
            **self._figures,
            "unsure_px": max(unsure_px, default=None),
            "latency_s": answer.latency_s,
            "captures": answer.captures,
            "rejected": answer.rejected,
        }


class Bursts:
    """Chooses the frames whose pictures the watcher gets: bursts of consecutive frames.

    A burst begins with the frame that stands when an exposure begins, and ends with the exposure. If exposures are
    unknown, bursts follow each other regularly.

    exposes : as in `Answer`.
    """

    def __init__(self, exposes: tuple[float, float, float] | tuple[()] = ()) -> None:
        self.exposes = exposes
        self._left = 0
        self._rests_until_s = self._last_s = float("-inf")

    def takes(self, now_s: float) -> bool:
        """Whether the picture of the frame that is shown from `now_s` on is sent."""
        frame_s, self._last_s = min(max(now_s - self._last_s, 1e-3), SLOWEST_S), now_s
        if not self._left and now_s >= self._rests_until_s:
            self._left = self._needed(now_s, frame_s)
            self._rests_until_s = now_s + PICTURE_EVERY_S * self._left
        self._left -= (taken := self._left > 0)
        return taken

    def _needed(self, now_s: float, frame_s: float) -> int:
        """Return how many frames from now on show all of an exposure; 0 if none begins during this frame."""
        if not self.exposes:
            return BURST
        first_s, last_s, period_s = self.exposes
        begins_s = now_s + (first_s - now_s) % period_s
        if begins_s >= now_s + frame_s:
            return 0
        return min(BURST, 1 + int((begins_s + last_s - first_s - now_s) / frame_s))


@dataclass
class _Shown:
    """A displayed frame.

    at_s : clock time at which it was shown.
    wanted : whether its picture should be sent.
    lit, pictured : whether its light and its picture have been sent.
    """

    at_s: float
    copies: ShownCopies[Any]
    wanted: bool
    lit: bool = False
    pictured: bool = False


def watching_properties(session: Session, watching: Watching | None) -> dict[str, Property]:
    def there() -> Watching:
        if watching is None:
            raise CommandError(ABSENT)
        return watching

    return {
        "watch-freeze": named("watch-freeze", lambda: there().frozen, lambda on: there().freeze(on)),
        "watch-state": Property(
            "state of --watch: state, reason, confidence, moved_px, gain, added_light (share of white), "
            "learned (share of the view), unsure_px, latency_s, captures, rejected; null without --watch",
            lambda: session.stats.facts.get("watch"),
        ),
        "watch-history": Property(
            "rows for every 20 s of the last twelve hours: time in seconds since 1970, moved_px, gain, added_light, "
            "confidence; null without --watch",
            lambda: None if watching is None else watching.history(),
            costly=True,
        ),
    }


def moved_of(found: Projected, device: Device) -> Moved:
    """Return the drift of one projector. Raises InputError or ValueError beyond the limits of a correction."""
    moved = Moved(np.array(found.to_raster, np.float64), np.array(found.gain, np.float64))
    if moved.to_raster.shape != (3, 3) or moved.gain.shape != (3,):
        raise ValueError(f"shapes {moved.to_raster.shape} and {moved.gain.shape}, expected (3, 3) and (3,)")
    if not np.isfinite(moved.to_raster).all() or not GAIN[0] <= moved.gain.min() <= moved.gain.max() <= GAIN[1]:
        raise ValueError(f"gain {found.gain}, expected {GAIN[0]} to {GAIN[1]}")
    moved.check(device)
    farthest = float(np.abs(moved.at_corners(device)).max())
    if not farthest <= farthest_px(device.shape):
        raise ValueError(
            f"corners {farthest:.1f} pixels from the calibration, expected {farthest_px(device.shape):.1f}"
        )
    return moved


def _field(answer: Answer) -> NDArray[np.float32]:
    if not answer.ambient:
        return NO_LIGHT
    field = np.array(answer.ambient, np.float32)
    most = *MOST_CELLS, 3
    if field.ndim != 3 or field.shape[2] != 3 or not field.size or any(np.greater(field.shape, most)):
        raise ValueError(f"ambient light of shape {field.shape}, expected at most {most}")
    if not np.isfinite(field).all():
        raise ValueError("ambient light that is no finite number")
    return field


def _read_paint(path: Path, camera: Device) -> NDArray[np.floating]:
    paint = np.load(path, allow_pickle=False)
    if paint.shape != (*camera.shape, 3) or not np.isfinite(paint).all():
        raise ValueError(f"{PAINT} of shape {paint.shape}, expected {(*camera.shape, 3)} and finite numbers")
    return np.asarray(paint)


def _read_gains(path: Path, camera: Device) -> NDArray[np.float32]:
    gains = np.load(path, allow_pickle=False)
    shape = (*blocks_of(camera.shape), 3)
    if gains.shape != shape or not ROW_GAINS[0] <= gains.min() <= gains.max() <= ROW_GAINS[1]:
        found = f"{gains.shape} and {gains.min():.3g} to {gains.max():.3g}"
        raise ValueError(f"{GAINS} of shape {found}, expected {shape} and {ROW_GAINS[0]} to {ROW_GAINS[1]}")
    return np.asarray(gains, np.float32)

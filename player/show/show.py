"""The main loop of a show: keys, remotes, session, overlay, heartbeat and status line."""

import gc
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager

import numpy as np

from counterlight.command import status
from counterlight.overlay.osd import Pointer
from counterlight.show.checked_room import CheckedRoom
from counterlight.show.commands import commands_of
from counterlight.show.control import Remote
from counterlight.show.keys import Keys
from counterlight.show.overlay import Overlay
from counterlight.show.registry import CommandError
from counterlight.show.session import Session
from counterlight.show.stats import Stats
from counterlight.show.stats_page import facts, status_line
from counterlight.show.watching import Watching
from counterlight.unattended.heartbeat import Heartbeat
from counterlight.unattended.pjlink import Lamps
from counterlight.unattended.room_checks import RoomChecks

STATUS_INTERVAL_S = 0.5
REDRAW = "redraw"  # pseudo-key: the window was resized or uncovered


class Show:
    """A session with its keys, remotes and overlay.

    bindings : key bindings of the settings file, see Keys.
    remotes : sources of commands.
    heartbeat : reports heartbeats; None for no reports.
    checks : checks of the room; None for none.
    watching : calibration from the running film; None for none. It ends with the show.
    lamps : projectors that remotes may switch.
    polled : functions called once per loop, which must not wait.
    on_interrupt : takes the counts if Ctrl-C or SIGTERM ends the show.
    """

    def __init__(
        self,
        session: Session,
        *,
        bindings: Mapping[str, str] | None = None,
        remotes: Sequence[Remote] = (),
        heartbeat: Heartbeat | None = None,
        checks: RoomChecks | None = None,
        watching: Watching | None = None,
        lamps: Lamps | None = None,
        polled: Sequence[Callable[[], None]] = (),
        on_interrupt: Callable[[Stats], None] = lambda _: None,
    ) -> None:
        self.session, self._watching = session, watching
        self.commands = commands_of(session, self._check, self._checking, lamps, watching)
        self._keys = Keys(self.commands, bindings)
        self._overlay = Overlay(session, self._keys)
        self._remotes, self._heartbeat = remotes, heartbeat
        self._status_at, self._polled, self._on_interrupt = float("-inf"), polled, on_interrupt
        self._checked = None if checks is None else CheckedRoom(session, self.commands, checks)

    def run(self, limit: int | None = None) -> Stats:
        """Play until the list ends, the window closes, `q`, or `limit` frames have been shown. Ends the session.

        Raises InputError if a medium that could not be played ended the show.
        """
        try:
            with short_collections():
                self._run(limit)
            return self.session.outcome()
        except KeyboardInterrupt:  # Ctrl-C or SIGTERM; the counts so far are valid
            self._on_interrupt(self.session.outcome())
            raise
        finally:
            status("")
            if self._checked is not None:
                self._checked.close()
            if self._watching is not None:
                self._watching.close()
            self.session.close()

    def _run(self, limit: int | None) -> None:
        session = self.session
        while not (session.done or session.display.closed):
            for key in session.display.poll(session.wait_s()):
                self.press(key)
            for pointer in session.display.pointers():
                self.point(pointer)
            for act in self._polled:
                act()
            self.step()
            for remote in self._remotes:  # right after a frame, when the most time is left before the next
                remote.poll(self.commands)
            if self._heartbeat is not None and self._heartbeat.due:
                self._heartbeat.beat(facts(session))
            self._tell_terminal()
            if limit is not None and session.stats.frames >= limit:
                return

    def _tell_terminal(self) -> None:
        session, now_s = self.session, time.monotonic()
        if session.playback is not None and now_s - self._status_at >= STATUS_INTERVAL_S:
            self._status_at = now_s
            status(status_line(session))

    def _check(self) -> str:
        if self._checked is None:
            raise CommandError("check-room: no camera is named; start with --check-with '--camera CAMERA …'")
        return self._checked.ask()

    def _checking(self) -> bool:
        return self._checked is not None and self._checked.running

    def step(self) -> None:
        """Show the frame that is due, with the page over it."""
        self.session.step(self._overlay.page)
        if self._checked is not None:
            self._checked.poll()
        if self._watching is not None:
            self._watching.poll(checking=self._checking())

    def point(self, pointer: Pointer) -> None:
        """Drag the picture that is being placed. Otherwise mouse movements have no effect."""
        session = self.session
        if session.placing is None:
            return
        if pointer.action == "release":
            self.commands.run("place-release")
            return
        at = np.array([[pointer.x, pointer.y]])
        x, y = session.room.pointed_at(at, session.view)[0]
        if not np.isfinite((x, y)).all():  # the point lies where the projector lights nothing
            return
        self.commands.run("place-grab" if pointer.action == "press" else "place-drag", float(x), float(y))

    def press(self, key: str) -> None:
        """Run a key's command and show on the screen what it changed. Unknown keys do nothing."""
        if key == REDRAW:
            self.session.uncovered()
            return
        if key == "escape" and self.session.help_page:
            self.session.help_page = 0
            self.session.changed()
            return
        said = self._keys.press(key, placing=self.session.placing is not None)
        if said:
            self.session.say(said)


@contextmanager
def short_collections() -> Iterator[None]:
    """Exclude the objects that exist now from garbage collections, which then take a fraction of a frame's time."""
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()

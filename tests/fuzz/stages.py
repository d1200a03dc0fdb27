"""Evenings of a supervised show under window managers: no desktop, decoration or text may reach the projector.

A trial is an evening under one window manager, with EVENTS random events, each followed by both films. The notes
report the projector's longest black after each kind of event, and the machine's load at the end.
"""

import os
import signal
import time
from collections import defaultdict
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import ClassVar

from counterlight.tools import build_correction_map
from counterlight.unattended.supervisor import MOST_CRASHES
from tests.audience import (
    ALWAYS,
    CURTAIN,
    LEVELS,
    MANAGERS,
    PLAYER,
    SILENT,
    Audience,
    Evening,
    change,
    closed_hours,
    runs,
    theatre,
    write_films,
    write_room,
)
from tests.desktop import xrandr
from tests.fuzz.tally import HUNG, READ, WRONG, Plan, Tally, Trial
from tests.programs import PATIENCE_S, children, descendants, is_running, on, running, verb, wait_until
from tests.remote import Client

EVENTS = 12
# duration of closed hours, so that the supervisor notices them after its player has ended, and forgets crashes
NOTICED_S = 2.0
DARK, BRIGHT = LEVELS


class Stages:
    """Each trial is an evening. The window managers take turns."""

    name, count = "stages", len(MANAGERS)
    purpose = "crashes, hangs, reloads, monitors and hours of a show, watched on its projector; a minute each"

    def run(self, plan: Plan) -> Tally:
        tally = Tally(self.name, plan)
        black: dict[str, float] = defaultdict(float)
        write_room(plan.scratch / "wall")
        assert build_correction_map.main([str(plan.scratch / "wall"), "--no-refine"]) == 0
        for index in plan.indices():
            folder = plan.scratch / str(index)
            folder.mkdir()
            manager = MANAGERS[index % len(MANAGERS)]
            names = plan.rng(self.name, index).choice(sorted(_Events.KINDS), EVENTS)
            tally.add(index, _evening(folder, plan.scratch / "wall", manager, list(names), black))
        tally.notes |= {f"{name}: black s": round(seconds, 2) for name, seconds in sorted(black.items())}
        tally.notes["load"] = round(os.getloadavg()[0], 1)
        return tally


def _evening(folder: Path, room: Path, manager: str, names: list[str], black: dict[str, float]) -> Trial:
    films = write_films(folder, 15)
    (folder / "hours.toml").write_text(ALWAYS)
    how = "--fullscreen", "--supervise", "--loop", "--control", folder / "socket", "--schedule", folder / "hours.toml"
    with ExitStack() as stack:
        display = stack.enter_context(theatre(folder, manager))
        audience = stack.enter_context(Audience(display, folder, composited=manager == "metacity"))
        process = stack.enter_context(running(*verb("play"), room, *films, *SILENT, *how, **on(display)))
        events = _Events(Evening(process, audience), display, folder)
        try:
            events.settle()
            black["start"] = max(black["start"], _longest_black_s(audience, 0))
            for name in names:
                count = len(audience.seen)
                events.KINDS[name](events)
                events.settle()
                black[name] = max(black[name], _longest_black_s(audience, count))
            process.terminate()
            process.wait(PATIENCE_S)
            audience.leaves()
        except AssertionError as error:
            return Trial(HUNG, f"{manager}: {error}", prompt=False)
        seen = audience.seen
        shown_again = "desktop" in seen[1:-1]
    wrong = audience.leaks or shown_again
    return Trial(WRONG if wrong else READ, f"{manager}: {audience.leaks or seen}", prompt=False)


def _longest_black_s(audience: Audience, first: int) -> float:
    """Return the longest black since the change of that number."""
    seen, since_s = audience.seen[first:], audience.since_s[first:]
    return max(
        (end - start for name, start, end in zip(seen, since_s, since_s[1:], strict=False) if name == "black"),
        default=0.0,
    )


class _Events:
    """Events of a show. Each method returns after the event."""

    def __init__(self, evening: Evening, display: str, folder: Path) -> None:
        self._evening, self._display, self._folder = evening, display, folder
        self._process = evening.process
        self._crashes = 0

    def settle(self) -> None:
        """Wait until both films have been seen."""
        self._evening.sees(DARK, BRIGHT)

    def crash(self) -> None:
        self._fall(signal.SIGSEGV)

    def hang(self) -> None:
        self._fall(signal.SIGSTOP)

    def decoder(self) -> None:
        for pid in descendants(self._evening.child(PLAYER)):
            os.kill(pid, signal.SIGSEGV)

    def curtain(self) -> None:
        pid = self._evening.child(CURTAIN)
        os.kill(pid, signal.SIGKILL)
        self._evening.child(CURTAIN, other_than=pid)

    def reload(self) -> None:
        with Client(self._folder / "socket") as client:
            assert client.ask("reload")["error"] == "success"

    def monitor(self) -> None:
        xrandr(self._display, "--output", "DUMMY1", "--off")
        self._evening.sees("")
        xrandr(self._display, "--output", "DUMMY1", "--mode", "256x192", "--pos", "1280x0")

    def hours(self) -> None:
        change(self._folder / "hours.toml", closed_hours())
        self._evening.sees("black")
        time.sleep(NOTICED_S)
        change(self._folder / "hours.toml", ALWAYS)
        self._crashes = 0

    def safe(self) -> None:
        """Crash the player until the safe picture appears, then restore the show."""
        last = 0
        while self._crashes < MOST_CRASHES:
            last = self._evening.child(PLAYER, other_than=last)
            os.kill(last, signal.SIGKILL)
            self._crashes += 1
        wait_until(lambda: not any(runs(pid, PLAYER) for pid in children(self._process.pid)), "black", self._process)
        self._evening.sees("black")
        self._process.send_signal(signal.SIGHUP)
        self._crashes = 0

    def _fall(self, number: int) -> None:
        """Kill or stop the player. If this failure would lead to the safe picture, run `safe` instead."""
        if self._crashes == MOST_CRASHES - 1:
            self.safe()
            return
        self._crashes += 1
        player = self._evening.child(PLAYER)
        for pid in (player, *descendants(player)) if number == signal.SIGSTOP else (player,):
            os.kill(pid, number)
        wait_until(lambda: not is_running(player), "its end", self._process)

    KINDS: ClassVar[dict[str, Callable[["_Events"], None]]] = {
        each.__name__: each for each in (crash, hang, decoder, curtain, reload, monitor, hours, safe)
    }

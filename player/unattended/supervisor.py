"""counterlight play --supervise: runs the player as a child process, and restarts it whenever it crashes or hangs.

The supervisor is the player's service manager. It receives READY=1, WATCHDOG=1 and the facts of heartbeat.py at
its inbox, and reports to systemd in turn. It holds no picture and no codec, so that little can crash it.

    crash        the player ends with a signal or an error code, or is silent for SILENCE_S
    back-off     0.1, 0.2, 0.4 … 2 s, doubled with every crash of the last WINDOW_S
    safe picture after MOST_CRASHES crashes: the show without compensation ("plain"), or black; SIGHUP tries again
    exit code 2  during a show something is missing or damaged: no crash; back-off 1, 2, 4 … 30 s
    schedule     outside its hours the picture is black, and a show that has ended restarts at its next hours
    curtain      a process that fills the monitors with black, below a full-screen show from its start to its end
"""

import ctypes
import os
import select
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any, TypeAlias

from counterlight.command import BAD_INPUT, DONE, INTERRUPTED, tell
from counterlight.unattended.heartbeat import INTERVAL_S, WAITING, Inbox, Notifier, read_facts
from counterlight.unattended.hours import Keeper, Schedule
from counterlight.unattended.waiting import retry_s

SILENCE_S = 3.0  # three heartbeats; with the longest back-off, the next player starts after 5 s
START_S = 60.0  # longest time to read the maps and compile the shaders
ENDING_S = 10.0  # longest time that a process takes to end after a request or its farewell
BACK_OFF_S, LONGEST_BACK_OFF_S = 0.1, 2.0
MOST_CRASHES, WINDOW_S = 5, 600.0
PROGRESS_S = 1.0  # a player that advanced less than this is not resumed at the same place
SAFE = ("black", "plain")
_POLL_S = 0.1
_SET_PDEATHSIG, _SET_CHILD_SUBREAPER = 1, 36  # numbers of prctl(2)
_LIBC = ctypes.CDLL(None)

Facts: TypeAlias = Mapping[str, object]
Player: TypeAlias = Callable[[Sequence[str]], list[str]]


@dataclass
class Crashes:
    """Counts a player's recent crashes."""

    clock: Callable[[], float] = time.monotonic
    _times: deque[float] = field(default_factory=lambda: deque(maxlen=MOST_CRASHES))

    def add(self) -> float:
        """Count a crash, and return the seconds to wait before the next start."""
        self._times.append(self.clock())
        return float(min(BACK_OFF_S * 2 ** (self._recent() - 1), LONGEST_BACK_OFF_S))

    @property
    def too_many(self) -> bool:
        return self._recent() >= MOST_CRASHES

    def forget(self) -> None:
        self._times.clear()

    def _recent(self) -> int:
        return sum(self.clock() - at <= WINDOW_S for at in self._times)


@dataclass
class Place:
    """The position of the show, where the next player resumes. After a second crash there, the item starts again."""

    item: int = 0
    time_s: float = 0.0
    _resumed: tuple[int, float] | None = None

    def follow(self, facts: Facts) -> None:
        item, time_s = facts.get("playlist_pos"), facts.get("time_pos")
        if isinstance(item, int) and isinstance(time_s, int | float):
            self.item, self.time_s = item, float(time_s)

    def options(self) -> list[str]:
        """Return the options that make a player resume here."""
        if self._resumed and self.item == self._resumed[0] and self.time_s < self._resumed[1] + PROGRESS_S:
            self.time_s = 0.0
        elif self._resumed is None and not (self.item or self.time_s):
            return []  # the first player, or a player that never played: the user's options apply
        self._resumed = self.item, self.time_s
        item = [f"--playlist-start={self.item}"] if self.item else []
        return [*item, f"--start={self.time_s:.3f}"]


class Child:
    """One process, the player or the curtain, with the inbox that it reports to."""

    def __init__(self, command: Sequence[str], inbox: Inbox, *, errors: int | None = None) -> None:
        self.ready = self.ending = self._killed = False
        self._inbox = inbox
        environment = {name: value for name, value in os.environ.items() if name != "WATCHDOG_USEC"}
        self.process = subprocess.Popen(
            command,
            env=environment | {"NOTIFY_SOCKET": inbox.address},
            stdin=subprocess.DEVNULL,
            stderr=errors,
            pass_fds=[inbox.theirs],
            process_group=0,  # own group, because the supervisor passes Ctrl-C on
            preexec_fn=_end_with_parent(os.getpid()),
        )
        inbox.handed_over()
        self._heard = self._looked = time.monotonic()

    def listen(self) -> dict[str, str]:
        """Return the variables received since the last call, the newest value of each."""
        told = self._inbox.drain()
        now = time.monotonic()
        # a long time since the last look means that the supervisor itself was stopped; this silence does not count
        if (told and not self.ending) or now - self._looked > 10 * _POLL_S:
            self._heard = now
        self._looked = now
        self.ready |= "READY" in told
        self.ending |= "STOPPING" in told
        return told

    @property
    def hangs(self) -> bool:
        """Whether the process has been silent for too long and has not been killed yet."""
        patience = ENDING_S if self.ending else SILENCE_S if self.ready else START_S
        return not self._killed and time.monotonic() - self._heard > patience

    def end(self, number: int) -> None:
        """Pass a signal that requests the end on to the process."""
        self.ending, self._heard = True, time.monotonic()
        self.process.send_signal(number)

    def kill(self) -> None:
        self._killed = True
        self.process.kill()


class Curtain:
    """The process that shows black. It is started again if it ends or hangs."""

    def __init__(self, command: Sequence[str]) -> None:
        self._command = command
        self._child: Child | None = None
        self._inbox: Inbox | None = None
        self._next_s, self._back_off_s = float("-inf"), BACK_OFF_S
        self._complaint = ""

    @property
    def ready(self) -> bool:
        return self._child is not None and self._child.ready

    @property
    def pid(self) -> int | None:
        return None if self._child is None else self._child.process.pid

    def keep(self, *, up: bool) -> None:
        """Start or stop the process without waiting. Prints its error lines and how it ended."""
        if not up:
            self.close()
        elif self._child is not None:
            self._watch(self._child)
        elif time.monotonic() >= self._next_s:
            self._inbox = Inbox()
            self._child = Child(self._command, self._inbox, errors=subprocess.PIPE)

    def close(self) -> None:
        if self._child is not None and self._inbox is not None:
            self._child.kill()
            self._child.process.communicate()
            self._inbox.close()
        self._child = self._inbox = None

    def _watch(self, child: Child) -> None:
        child.listen()
        ended = child.process.poll()
        assert child.process.stderr is not None
        os.set_blocking(child.process.stderr.fileno(), False)
        lines = (child.process.stderr.read() or b"").decode(errors="replace").splitlines()
        for line in lines or ([] if ended is None else [f"ended with {_how(ended)}"]):
            self._complain(line.removeprefix("error: "))
        if ended is not None:
            self._next_s = time.monotonic() + self._back_off_s
            self._back_off_s = min(2 * self._back_off_s, LONGEST_BACK_OFF_S)
            self.close()
        elif child.hangs:
            child.kill()
        elif child.ready:
            self._back_off_s = BACK_OFF_S

    def _complain(self, line: str) -> None:
        """Print a line, unless it repeats the last line."""
        if line != self._complaint:
            _say(f"the black curtain: {line}")
        self._complaint = line


class Supervisor:
    """Keeps a show running.

    players : command lines of the show and of the safe pictures, in the order of the attempts. Each takes the options
        that resume a show. After the last player, only the curtain is shown.
    curtain : shows black.
    notifier : reports to the service manager that started the supervisor.
    plays : whether the schedule says that the show plays now.
    below : whether the curtain also runs while a player runs, in windows below the player's windows.
    opens : returns when the show begins next by the schedule; None if unknown.
    """

    def __init__(
        self,
        players: Sequence[Player],
        curtain: Curtain,
        notifier: Notifier,
        plays: Callable[[], bool] | None = None,
        *,
        below: bool,
        opens: Callable[[], datetime | None] = lambda: None,
    ) -> None:
        self._players, self._notifier, self._plays, self._opens = players, notifier, plays, opens
        self._curtain, self._below = curtain, below
        # whether the show played by the schedule at the last look, and whether the show has ended since
        self._open, self._over = True, False
        self._level = self._refusals = 0
        self._crashes, self._place = Crashes(), Place()
        self._signal: int | None = None
        self._again = self._began = self._ready = False
        self._told_at = float("-inf")

    def run(self) -> int:
        """Run until a player ends normally, a signal asks for the end, or no player can start with these options.

        Returns the exit code of the last player, 130 if a signal ended it.
        """
        _prctl(_SET_CHILD_SUBREAPER, 1)
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
            signal.signal(number, self._on_signal)
        self._open = self._is_time()
        if not self._open:
            self._say_black("closed, by its schedule: black until the show begins")
        try:
            return self._run()
        finally:
            self._curtain.close()

    def _run(self) -> int:
        code: int | None
        while True:
            if self._is_black:
                code = self._wait_in_black()
            else:
                with Inbox() as inbox:
                    code = self._play(inbox)
            if self._turns() or code is None:
                continue
            if self._has_ended(code):
                self._rest(BACK_OFF_S)
                continue
            if self._is_final(code):
                return code
            if not self._again:
                self._rest(self._pause_s(code))
            if self._signal is not None:
                return INTERRUPTED
            self._choose()

    def _pause_s(self, code: int) -> float:
        """Return the seconds until the next start. A part that is missing, or bad input, does not count as a crash."""
        if code != BAD_INPUT:
            return self._crashes.add()
        self._refusals += 1
        return retry_s(self._refusals - 1)

    @property
    def _is_black(self) -> bool:
        return not self._open or self._over or self._level == len(self._players)

    def _wait_in_black(self) -> int:
        """Show only the curtain until the schedule changes or a signal arrives. Returns 130 if the signal is to end."""
        while self._signal is None and not self._again and self._is_time() == self._open:
            self._curtain.keep(up=True)
            self._began |= self._curtain.ready
            self._tell()
            time.sleep(_POLL_S)
        return DONE if self._signal is None else INTERRUPTED

    def _play(self, inbox: Inbox) -> int | None:
        """Run one player to its end. Returns its exit code, negative for a signal, or None if the schedule ended it."""
        self._curtain.keep(up=self._below)
        child = Child(self._players[self._level](self._place.options()), inbox)
        passed_on = turned = False
        try:
            while child.process.poll() is None:
                self._hear(child)
                self._curtain.keep(up=self._below)
                if self._signal is not None and not passed_on:
                    child.end(self._signal)
                    passed_on = True
                elif (self._again or self._is_time() != self._open) and not child.ending:
                    turned = not self._again
                    child.end(signal.SIGTERM)
                elif child.hangs:
                    _say("the player hangs: ended")
                    child.kill()
                select.select([inbox], [], [], _POLL_S)
            self._hear(child)  # reads the child's last messages
        finally:
            child.kill()
            child.process.wait()
            _end_orphans(but=self._curtain.pid)
        return INTERRUPTED if passed_on else None if turned else child.process.returncode

    def _hear(self, child: Child) -> None:
        told = child.listen()
        facts = read_facts(told)
        self._place.follow(facts)
        if "READY" in told:
            self._refusals = 0
        self._began |= "READY" in told or WAITING in facts
        self._tell(told.get("STATUS", ""))

    def _tell(self, status: str = "") -> None:
        """Report to the service manager once a second. Repeat READY=1 until it has been sent."""
        if status or time.monotonic() - self._told_at >= INTERVAL_S:
            self._told_at = time.monotonic()
            variables = {"WATCHDOG": "1"} | ({"STATUS": status} if status else {})
            if self._began and not self._ready:
                self._ready = self._notifier.send(READY="1", **variables)
            else:
                self._notifier.send(**variables)

    def _is_time(self) -> bool:
        return self._plays is None or self._plays()

    def _turns(self) -> bool:
        """Whether the show's hours have begun or ended. The show then starts from its beginning, or black is shown."""
        if self._signal is not None or self._is_time() == self._open:
            return False
        self._open, self._over, self._place, self._level = not self._open, False, Place(), 0
        self._crashes.forget()
        if self._open:
            _say("the show begins, by its schedule")
        else:
            self._say_black("the show ends, by its schedule: black until the next show")
        return True

    def _has_ended(self, code: int) -> bool:
        """Whether a scheduled show has ended or was quit. Black is then shown until its next hours."""
        if self._plays is None or code != DONE or self._signal is not None or self._again:
            return False
        if self._open and not self._over:
            self._say_black("the show has ended: black until its next hours")
        self._over, self._place = True, Place()
        return True

    def _say_black(self, line: str) -> None:
        """Print why the picture is black, and when the show begins; also as the status of the service."""
        opens = self._opens()
        line = line if opens is None else f"{line}, {opens:%Y-%m-%d %H:%M}"
        _say(line)
        self._tell(line)

    def _is_final(self, code: int) -> bool:
        """Whether the show ends with this exit code. Otherwise the player has crashed, and a line reports this."""
        if self._again and self._signal is None:
            return False
        if code in (DONE, INTERRUPTED) or (code == BAD_INPUT and not self._began):
            return True
        place = f"item {self._place.item}, {self._place.time_s:.1f} s"
        _say(f"the player has ended with {_how(code)} at {place}; starting it again")
        return False

    def _choose(self) -> None:
        """Choose the next player: the show after SIGHUP, a safer picture after too many crashes."""
        if self._again:
            self._again, self._over, self._level, self._refusals = False, False, 0, 0
            self._crashes.forget()
            _say("starting the player again, as told")
        elif self._crashes.too_many:
            self._level += 1
            self._crashes.forget()
            _say(f"{MOST_CRASHES} crashes: going to the safe picture; kill -HUP {os.getpid()} tries again")

    def _rest(self, seconds: float) -> None:
        """Wait, unless a signal arrives."""
        until = time.monotonic() + seconds
        while time.monotonic() < until and self._signal is None and not self._again:
            self._curtain.keep(up=self._below)
            self._tell()
            time.sleep(min(_POLL_S, max(until - time.monotonic(), 0.0)))

    def _on_signal(self, number: int, _: Any) -> None:
        if number == signal.SIGHUP:
            self._again = True
        else:
            self._signal = number


def supervise(
    arguments: Sequence[str],
    *,
    safe: str,
    monitors: Sequence[str],
    fullscreen: bool,
    plain_options: Sequence[str],
    notify_socket: str | None,
    schedule: Callable[[], Schedule] | None = None,
) -> int:
    """Run `counterlight play ARGUMENTS` under supervision, and return its exit code.

    arguments : the whole command line, with `--supervise`. Options for the player are added to it.
    safe : one of SAFE.
    monitors : where black is shown; empty for the primary monitor.
    fullscreen : whether the show fills the monitors, above the curtain.
    plain_options : options that show the media without compensation.
    notify_socket : value of NOTIFY_SOCKET, None without a service manager.
    schedule : returns the present schedule; None for a show that always plays.
    """
    python = [sys.executable, "-P", "-m"]

    def play(resume: Sequence[str], *options: str) -> list[str]:
        return [
            *python,
            "counterlight.app",
            *with_options(arguments, "--no-supervise", "--supervised", *options, *resume),
        ]

    def plain(resume: Sequence[str]) -> list[str]:
        return play(resume, *plain_options)

    def plays() -> bool:
        return schedule is None or schedule().plays(datetime.now())

    def opens() -> datetime | None:
        return None if schedule is None else schedule().opens(datetime.now())

    notifier, keeper = Notifier(notify_socket), None if schedule is None else Keeper(schedule)
    players: list[Player] = [play, plain] if safe == "plain" else [play]
    curtain = Curtain([*python, "counterlight.gl.curtain", *monitors])
    try:
        planned = None if schedule is None else plays
        return Supervisor(players, curtain, notifier, planned, below=fullscreen, opens=opens).run()
    finally:
        if keeper is not None:
            keeper.close()
        notifier.send(STOPPING="1")
        notifier.close()


def with_options(arguments: Sequence[str], *options: str) -> list[str]:
    """Add options to a command line before a `--`, where they are still parsed as options."""
    end = list(arguments).index("--") if "--" in arguments else len(arguments)
    return [*arguments[:end], *options, *arguments[end:]]


def _end_with_parent(parent: int) -> Callable[[], None]:
    """Return a function that a child runs between fork and exec, so that it ends when the supervisor is killed."""

    def ask() -> None:
        _prctl(_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:  # the parent has ended meanwhile
            os._exit(1)

    return ask


def _end_orphans(*, but: int | None) -> None:
    """End the processes that a dead player left behind, such as a stopped decoder. This subreaper has inherited them.

    All children of this process but `but` belong to the player.

    but : process of the curtain.
    """
    while orphans := [pid for pid in _children() if pid != but]:
        for pid in orphans:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
            with suppress(ChildProcessError):
                os.waitpid(pid, 0)


def _children() -> list[int]:
    with suppress(OSError):  # not Linux, or a kernel without this file
        return [int(pid) for pid in Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()]
    return []


def _prctl(option: int, value: int) -> None:
    if sys.platform == "linux":
        _LIBC.prctl(option, value, 0, 0, 0)


def _how(code: int) -> str:
    return f"signal {-code}" if code < 0 else f"exit code {code}"


def _say(line: str) -> None:
    tell(f"supervisor: {line}")

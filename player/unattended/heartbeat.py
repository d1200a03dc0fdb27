"""Heartbeats: one JSON line per interval to the supervisor, and systemd's notification protocol (sd_notify(3))."""

import json
import os
import select
import socket
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Self

from counterlight.errors import InputError, printable
from counterlight.unattended.json_lines import encode

INHERITED = "fd:"  # prefix of a heartbeat.Notifier address; an inherited socket's number follows
MOST = 64  # messages per call, so that a flood of messages cannot block the supervisor


class Inbox:
    """Receives sd_notify(3) messages from one process, which inherits `theirs` and finds `address` in NOTIFY_SOCKET."""

    def __init__(self) -> None:
        self._ours, self._theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._ours.setblocking(False)
        self.theirs = self._theirs.fileno()
        self.address = f"{INHERITED}{self.theirs}"

    def handed_over(self) -> None:
        """Close this process's copy of `theirs`, after the child process has been started."""
        self._theirs.close()

    def fileno(self) -> int:
        return self._ours.fileno()

    def drain(self) -> dict[str, str]:
        """Return the variables received since the last call, the newest value of each."""
        told: dict[str, str] = {}
        with suppress(OSError):  # no more messages, or the process has gone
            for _ in range(MOST):
                lines = self._ours.recv(1 << 16).decode(errors="replace").splitlines()
                told |= dict(line.split("=", 1) for line in lines if "=" in line)
        return told

    def close(self) -> None:
        self._ours.close()
        self._theirs.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, _: TracebackType | None) -> None:
        self.close()


INTERVAL_S = 1.0
MAX_LOG_BYTES = 16 << 20  # FILE is then renamed to FILE.1, so that a show of months does not fill the disk.
WAITING = "waiting"  # the fact that names what a show waits for
FACTS = "X_COUNTERLIGHT"  # systemd ignores variables that begin with X_; the supervisor reads this variable


class Notifier:
    """Sends the show's state to a service manager's datagram socket. A missing manager is no error."""

    def __init__(self, address: str | None) -> None:
        """Open the socket.

        address : value of NOTIFY_SOCKET (a path, or `@` and an abstract name), or an Inbox's address; None sends
            nothing.
        """
        self._address: str | None = None
        self._socket: socket.socket | None = None
        if address and address.startswith(INHERITED):
            with suppress(OSError, ValueError):
                self._socket = socket.socket(fileno=int(address.removeprefix(INHERITED)))
        elif address:
            self._address = "\0" + address[1:] if address.startswith("@") else address
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        if self._socket is not None:
            self._socket.setblocking(False)

    def send(self, **variables: str) -> bool:
        """Send variables. Returns False if they were not sent, for example because the manager's buffer is full."""
        if self._socket is not None:
            message = "\n".join(f"{name}={value}" for name, value in variables.items()).encode()
            with suppress(OSError):
                sent = self._socket.sendto(message, self._address) if self._address else self._socket.send(message)
                return sent > 0
        return False

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()


class Heartbeat:
    """Reports a show's facts, at most once per interval. Other calls only read the clock.

    A line holds `time` (Unix, seconds), `pid`, `rss_bytes`, `fps` (frames shown since the last line) and the facts.

    target : a file that lines are appended to, "-" for stderr, None for no lines.
    notifier : receives READY=1 with the first beat without `waiting`, WATCHDOG=1 and the facts with every beat.
    interval_s : shortest time between two beats.
    clock : seconds, monotonic.
    """

    def __init__(
        self,
        target: Path | str | None,
        notifier: Notifier,
        *,
        interval_s: float = INTERVAL_S,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._path = None if target is None or str(target) == "-" else Path(target)
        self._file = None if target is None else sys.stderr.fileno() if self._path is None else _open(self._path)
        self._notifier, self._interval_s, self._clock = notifier, interval_s, clock
        self._told_at = float("-inf")
        self._frames: object = None
        self._ready = False  # whether READY=1 was sent

    @property
    def due(self) -> bool:
        """Whether the next call of `beat` will report. If not, no facts need to be collected."""
        return self._clock() - self._told_at >= self._interval_s

    def beat(self, facts: Mapping[str, object]) -> None:
        """Report the facts (JSON values) if an interval has passed since the last report."""
        if not self.due:
            return
        now, frames = self._clock(), facts.get("frames")
        facts = {**facts, **self._rate(frames, now - self._told_at)}
        first = not self._ready and WAITING not in facts
        sent = self._notifier.send(
            **({"READY": "1"} if first else {}),
            WATCHDOG="1",
            STATUS=_status(facts),
            **{FACTS: encode(facts).decode().strip()},
        )
        self._ready |= first and sent
        self._told_at, self._frames = now, frames
        if self._file is not None:
            self._write(encode({"time": round(time.time(), 3), "pid": os.getpid(), "rss_bytes": rss_bytes()} | facts))

    def close(self) -> None:
        """Announce that no more beats will follow, and close the files."""
        self._notifier.send(STOPPING="1")
        self._notifier.close()
        if self._file is not None and self._path is not None:
            os.close(self._file)
        self._file = None

    def _rate(self, frames: object, seconds: float) -> dict[str, float]:
        if isinstance(frames, int) and isinstance(self._frames, int) and seconds > 0:
            return {"fps": round(max(frames - self._frames, 0) / seconds, 2)}
        return {}

    def _write(self, line: bytes) -> None:
        """Append a line. Skip it if writing would wait (full pipe) or fails (full disk): the show must continue."""
        assert self._file is not None
        with suppress(OSError, InputError):
            if not select.select([], [self._file], [], 0)[1]:
                return
            os.write(self._file, line)
            if self._path is not None and os.fstat(self._file).st_size > MAX_LOG_BYTES:
                self._path.replace(self._path.with_name(self._path.name + ".1"))
                fresh = _open(self._path)
                os.close(self._file)
                self._file = fresh


def rss_bytes(pid: int | str = "self") -> int | None:
    """Return the resident memory of a process in bytes, from Linux's /proc. None on other systems."""
    try:
        pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    except OSError:
        return None
    return pages * os.sysconf("SC_PAGE_SIZE")


def read_facts(message: Mapping[str, str]) -> dict[str, object]:
    """Return the facts of a beat that a Notifier sent. Empty if they cannot be read."""
    try:
        facts = json.loads(message.get(FACTS, "{}"))
    except ValueError:
        return {}
    return facts if isinstance(facts, dict) else {}


def _status(facts: Mapping[str, object]) -> str:
    told = (f"{name} {facts[name]}" for name in (WAITING, "path", "time_pos", "fps", "dropped") if name in facts)
    return printable(", ".join(told))  # one line, whatever the file's name contains


def _open(path: Path) -> int:
    flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NONBLOCK | os.O_CLOEXEC
    try:
        return os.open(path, flags, 0o644)
    except OSError as error:
        raise InputError(f"{path}: no heartbeat can be written here ({error.strerror}); name another file") from None

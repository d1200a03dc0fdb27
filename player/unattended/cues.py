"""Sends a show's position from machine to machine, and estimates the difference between their clocks.

A follower asks, and the leader answers at once. Both use their own threads, so that drawing a frame delays no answer.
An answer has as many bytes as its question, and a question has no other effect. Everyone who can send a question learns
the position of the show.

A question leaves at time a. Its answer arrives at time c, and holds the other clock's time b. If both directions take
equally long, the other clock is ahead by b − (a + c) / 2. The error of this difference is at most (c − a) / 2 in any
case (Cristian 1989). Delays come in bursts, so the quickest round trips are the most accurate. The estimate is the
median of the quickest quarter of the last 32 round trips.
"""

import math
import os
import socket
import struct
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from statistics import median

from counterlight.errors import InputError

KEPT, QUICKEST = 32, 4  # kept round trips; the quickest 1 / QUICKEST of them are used
LEAST = 5  # fewest round trips for an estimate


class ClockOffset:
    def __init__(self) -> None:
        self._trips: deque[tuple[float, float]] = deque(maxlen=KEPT)  # duration and offset of each trip

    def add(self, asked_s: float, theirs_s: float, answered_s: float) -> None:
        """Add a round trip.

        asked_s : local time of the question.
        theirs_s : the other clock's time in the answer.
        answered_s : local time of the answer.
        """
        self._trips.append((answered_s - asked_s, theirs_s - (asked_s + answered_s) / 2))

    def forget(self) -> None:
        """Discard all round trips, because the other clock has changed."""
        self._trips.clear()

    @property
    def seconds(self) -> float | None:
        """The other clock's time minus the local time. None before LEAST round trips."""
        if len(self._trips) < LEAST:
            return None
        return median(offset for _, offset in self._quickest())

    @property
    def round_trip_s(self) -> float | None:
        """The slowest counted round trip. The error of `seconds` is at most half of it if both clocks run evenly."""
        return self._quickest()[-1][0] if self._trips else None

    def _quickest(self) -> list[tuple[float, float]]:
        return sorted(self._trips)[: max(len(self._trips) // QUICKEST, 1)]


PORT, EVERYWHERE = 7325, "0.0.0.0"
MAGIC = b"CLc1"
MESSAGE = struct.Struct("!4sBxxxIIddiddd")  # magic, state, run, number, asked, answered; item, media, at, speed
PAUSED, MOVING = 1, 2  # bits of a message's state
FIRST_ASKED_S, ASKED_S = 0.05, 0.2  # time between questions until the leader's clock is known, and afterwards
SILENT_S = 3.0  # time without an answer after which the leader counts as silent
UNANSWERED = 64  # number of questions whose answers are still accepted
LATEST = 1e12  # largest accepted time, in seconds


@dataclass(frozen=True)
class Cue:
    """The position of a show.

    item : position in the list; -1 while nothing plays.
    media_s : media time that was due at clock time `at_s`.
    at_s : the leader's clock time.
    speed : media seconds per second.
    paused : whether the show is paused.
    moving : whether media time advances.
    """

    item: int = -1
    media_s: float = 0.0
    at_s: float = 0.0
    speed: float = 1.0
    paused: bool = False
    moving: bool = False


@dataclass(frozen=True)
class Heard:
    """A leader's answer.

    cue : the leader's last cue.
    offset_s : the leader's clock minus the local clock.
    round_trip_s : see ClockOffset.
    """

    cue: Cue
    offset_s: float
    round_trip_s: float


class Beacon:
    """Answers followers. Raises InputError if it cannot listen.

    address : (host, port); an empty host means all addresses of this machine.
    """

    def __init__(self, address: tuple[str, int], clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._cue, self._run = clock, Cue(), int.from_bytes(os.urandom(4))
        self._socket = _listening(address)
        self.address: tuple[str, int] = self._socket.getsockname()[:2]
        self._closed = False
        self._thread = threading.Thread(target=self._answer, name="beacon", daemon=True)
        self._thread.start()

    def tell(self, cue: Cue) -> None:
        """Set the cue that is sent from now on."""
        self._cue = cue

    def close(self) -> None:
        self._closed = True
        self._thread.join()
        self._socket.close()

    def _answer(self) -> None:
        while not self._closed:
            with suppress(OSError):  # no question has come, or the follower has gone
                question, sender = self._socket.recvfrom(MESSAGE.size + 1)
                if len(question) == MESSAGE.size and question.startswith(MAGIC):
                    _, _, _, number, asked_s, *_ = MESSAGE.unpack(question)
                    self._socket.sendto(self._message(number, asked_s), sender)

    def _message(self, number: int, asked_s: float) -> bytes:
        cue, now_s = self._cue, self._clock()
        state = PAUSED * cue.paused + MOVING * cue.moving
        place = cue.item, cue.media_s, cue.at_s, cue.speed
        return MESSAGE.pack(MAGIC, state, self._run, number, asked_s, now_s, *place)


class Listener:
    """Asks a leader for its position, without end. Waits for a leader that has not started or has ended."""

    def __init__(self, address: tuple[str, int], clock: Callable[[], float] = time.monotonic) -> None:
        self._address, self._clock = address, clock
        self._offset, self._run = ClockOffset(), 0
        self._heard: Heard | None = None
        self._heard_at_s = float("-inf")
        self._number = 0
        self._asked: dict[int, float] = {}  # time of each unanswered question, by its number
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._listen, name="listener", daemon=True)
        self._thread.start()

    @property
    def heard(self) -> Heard | None:
        """The leader's answer. None while the leader is silent or its clock is unknown."""
        return self._heard if self._clock() - self._heard_at_s < SILENT_S else None

    def close(self) -> None:
        self._closed.set()
        self._thread.join(ASKED_S)  # the thread may be waiting for a name lookup

    def _listen(self) -> None:
        while not self._closed.is_set():
            with suppress(OSError), _connected(self._address) as link:  # no such host or network: tries again soon
                last_s = self._clock()
                while not self._closed.is_set() and self._clock() - max(last_s, self._heard_at_s) < SILENT_S:
                    self._ask(link)
            self._closed.wait(ASKED_S)

    def _ask(self, link: socket.socket) -> None:
        """Send one question, and take every answer until the next question is due."""
        self._number = (self._number + 1) % (1 << 32)
        asked_s = self._clock()
        self._asked[self._number] = asked_s
        while len(self._asked) > UNANSWERED:
            del self._asked[next(iter(self._asked))]
        link.send(MESSAGE.pack(MAGIC, 0, 0, self._number, asked_s, 0.0, -1, 0.0, 0.0, 1.0))
        until_s = asked_s + (FIRST_ASKED_S if self._offset.seconds is None else ASKED_S)
        while (wait_s := until_s - self._clock()) > 0 and not self._closed.is_set():
            link.settimeout(wait_s)
            with suppress(TimeoutError, ConnectionRefusedError):
                self._take(link.recv(MESSAGE.size + 1), self._clock())

    def _take(self, answer: bytes, now_s: float) -> None:
        if len(answer) != MESSAGE.size or not answer.startswith(MAGIC):
            return
        _, state, run, number, _, answered_s, item, media_s, at_s, speed = MESSAGE.unpack(answer)
        asked_s = self._asked.pop(number, None)
        if asked_s is None or not _are_times(answered_s, media_s, at_s) or not 0.01 <= speed <= 100 or item < -1:
            return
        if run != self._run:
            self._run = run
            self._offset.forget()
        self._offset.add(asked_s, answered_s, now_s)
        offset_s, round_trip_s = self._offset.seconds, self._offset.round_trip_s
        if offset_s is not None and round_trip_s is not None:
            cue = Cue(item, media_s, at_s, speed, bool(state & PAUSED), bool(state & MOVING))
            self._heard, self._heard_at_s = Heard(cue, offset_s, round_trip_s), now_s


def read_address(text: str, *, host: str | None = None, port: int | None = None) -> tuple[str, int]:
    """Parse `HOST:PORT` or `[::1]:PORT`. A part with a default may be omitted. Raises ValueError otherwise."""
    before, colon, after = text.rpartition(":")
    if (text.startswith("[") and text.endswith("]")) or not colon:
        before, after = (text, "") if port is not None else ("", text)
    name = before.removeprefix("[").removesuffix("]") or host
    if name is None or (":" in name and not before.startswith("[")):
        raise ValueError(text)
    number = int(after) if after.isascii() and after.isdecimal() and len(after) < 6 else port if not after else None
    if number is None or not 0 < number < 1 << 16:
        raise ValueError(text)
    name.encode("idna")  # raises UnicodeError, a ValueError, for an impossible name
    return name, number


def _are_times(*seconds: float) -> bool:
    return all(math.isfinite(each) and abs(each) < LATEST for each in seconds)


def _listening(address: tuple[str, int]) -> socket.socket:
    host, port = address
    try:
        kind, *_, where = socket.getaddrinfo(host or EVERYWHERE, port, type=socket.SOCK_DGRAM)[0]
        made = socket.socket(kind, socket.SOCK_DGRAM)
        try:
            made.settimeout(SILENT_S / 10)
            made.bind(where)
        except OSError:
            made.close()
            raise
    except OSError as error:
        raise InputError(
            f"--lead {host + ':' if host else ''}{port}: cannot listen there ({error.strerror or error}); "
            "give another port, or an address of this machine"
        ) from None
    return made


def _connected(address: tuple[str, int]) -> socket.socket:
    """Return a socket that receives only from the leader."""
    kind, *_, where = socket.getaddrinfo(*address, type=socket.SOCK_DGRAM)[0]
    made = socket.socket(kind, socket.SOCK_DGRAM)
    try:
        made.connect(where)
    except OSError:
        made.close()
        raise
    return made

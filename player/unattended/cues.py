"""Where a show is, told from machine to machine: questions and answers in datagrams of one size.

A follower asks, the leader answers at once, by threads of their own, so that nobody's frame delays a clock. An answer
is no longer than its question, and a question changes nothing: whoever may send one learns where the show is.
"""

import math
import os
import socket
import struct
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

from counterlight.errors import InputError
from counterlight.unattended.clocks import ClockOffset

PORT, EVERYWHERE = 7325, "0.0.0.0"
MAGIC = b"CLc1"
MESSAGE = struct.Struct("!4sBxxxIIddiddd")  # magic, state, run, number, asked, answered; item, media, at, speed
PAUSED, MOVING = 1, 2  # bits of the state
FIRST_ASKED_S, ASKED_S = 0.05, 0.2  # between questions, until a clock is known, and then
SILENT_S = 3.0  # without an answer
UNANSWERED = 64  # questions whose answers are still taken
LATEST = 1e12  # of any time


@dataclass(frozen=True)
class Cue:
    """Where a show is: at clock time `at_s` (the leader's) `media_s` of the list's item was due.

    item : -1 while nothing plays.  moving : whether time goes on, `speed` media seconds a second.
    """

    item: int = -1
    media_s: float = 0.0
    at_s: float = 0.0
    speed: float = 1.0
    paused: bool = False
    moving: bool = False


@dataclass(frozen=True)
class Heard:
    """cue : the leader's last one.  offset_s : its clock less ours.  round_trip_s : see ClockOffset."""

    cue: Cue
    offset_s: float
    round_trip_s: float


class Beacon:
    """Answers followers; raises InputError where it cannot listen.

    address : (host, port); an empty host is every one of this machine.
    """

    def __init__(self, address: tuple[str, int], clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._cue, self._run = clock, Cue(), int.from_bytes(os.urandom(4))
        self._socket = _listening(address)
        self.address: tuple[str, int] = self._socket.getsockname()[:2]
        self._closed = False
        self._thread = threading.Thread(target=self._answer, name="beacon", daemon=True)
        self._thread.start()

    def tell(self, cue: Cue) -> None:
        """What is answered from now on."""
        self._cue = cue

    def close(self) -> None:
        self._closed = True
        self._thread.join()
        self._socket.close()

    def _answer(self) -> None:
        while not self._closed:
            with suppress(OSError):  # nobody asks; or he that asked is no longer there
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
    """Asks a leader where the show is, for ever; one that is not there yet, or no longer, is waited for."""

    def __init__(self, address: tuple[str, int], clock: Callable[[], float] = time.monotonic) -> None:
        self._address, self._clock = address, clock
        self._offset, self._run = ClockOffset(), 0
        self._heard: Heard | None = None
        self._heard_at_s = float("-inf")
        self._number = 0
        self._asked: dict[int, float] = {}  # number, when
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._listen, name="listener", daemon=True)
        self._thread.start()

    @property
    def heard(self) -> Heard | None:
        """What the leader says; None while it is silent or its clock not yet known."""
        return self._heard if self._clock() - self._heard_at_s < SILENT_S else None

    def close(self) -> None:
        self._closed.set()
        self._thread.join(ASKED_S)  # it may be waiting for a name to be found

    def _listen(self) -> None:
        while not self._closed.is_set():
            with suppress(OSError), _connected(self._address) as link:  # no such host, no network: again, soon
                last_s = self._clock()
                while not self._closed.is_set() and self._clock() - max(last_s, self._heard_at_s) < SILENT_S:
                    self._ask(link)
            self._closed.wait(ASKED_S)

    def _ask(self, link: socket.socket) -> None:
        """One question, and every answer that comes until the next is due."""
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
    """`HOST:PORT`, `[::1]:PORT`, and whichever half the defaults allow to be left out; ValueError otherwise."""
    before, colon, after = text.rpartition(":")
    if (text.startswith("[") and text.endswith("]")) or not colon:
        before, after = (text, "") if port is not None else ("", text)
    name = before.removeprefix("[").removesuffix("]") or host
    if name is None or (":" in name and not before.startswith("[")):
        raise ValueError(text)
    number = int(after) if after.isascii() and after.isdecimal() and len(after) < 6 else port if not after else None
    if number is None or not 0 < number < 1 << 16:
        raise ValueError(text)
    name.encode("idna")  # a UnicodeError is a ValueError
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
    """A socket that hears nobody but the leader."""
    kind, *_, where = socket.getaddrinfo(*address, type=socket.SOCK_DGRAM)[0]
    made = socket.socket(kind, socket.SOCK_DGRAM)
    try:
        made.connect(where)
    except OSError:
        made.close()
        raise
    return made

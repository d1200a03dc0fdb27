"""Controls projectors over the network: PJLink class 1 (JBMIA's specification 1.04), on TCP port 4352.

    projector   PJLINK 0, or PJLINK 1 and eight characters if it needs a password
    we          %1POWR 1, preceded by the MD5 of these characters and the password if it needs a password
    projector   %1POWR=OK, or =ERR1 to =ERR4, or PJLINK ERRA for a wrong password

A carriage return ends each line. Each connection is short, because a projector closes it after 30 s of silence.
"""

import hashlib
import socket
import threading
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any

from counterlight.errors import InputError, one_line

PORT = 4352
ANSWER_S = 5.0  # time to answer; class 1 allows a projector 2 s
LONGEST_LINE = 136 + 128  # bytes of class 1's longest line, and a reserve
POWERS = ("off", "on", "cooling", "warming up")
PARTS = ("fan", "lamp", "temperature", "cover", "filter", "other")
STATES = ("", "warning", "error")
REFUSALS = {
    "ERR1": "it does not know this command",
    "ERR2": "it does not take this value",
    "ERR3": "not now: it warms up or cools down",
    "ERR4": "the projector has failed",
}


@dataclass(frozen=True)
class Projector:
    """The address of a projector.

    host : name or IP address.
    port : TCP port.
    password : if the projector needs a password.
    """

    host: str
    port: int = PORT
    password: str = ""

    def __str__(self) -> str:
        return self.host if self.port == PORT else f"{self.host}:{self.port}"


@dataclass(frozen=True)
class Status:
    """The state of a projector.

    power : one of POWERS.
    lamp_hours : hours of each lamp.
    faults : such as `filter: warning`.
    """

    power: str
    lamp_hours: tuple[int, ...] = ()
    faults: tuple[str, ...] = ()

    @property
    def settled(self) -> bool:
        """Whether the projector accepts orders. It does not while it warms up or cools down."""
        return self.power in ("on", "off")

    def __str__(self) -> str:
        hours = [f"{hours} h of lamp" for hours in self.lamp_hours]
        return ", ".join([self.power, *hours, *self.faults])


def switch(projector: Projector, *, on: bool) -> None:
    """Make the projector warm up or cool down, which takes a minute or more. Raises InputError if it refuses."""
    with closing(_Link(projector)) as link:
        answer = link.ask("POWR", "1" if on else "0")
        if answer != "OK":
            raise link.wrong(f"POWR {'1' if on else '0'}", answer)


def status_of(projector: Projector) -> Status:
    """Query a projector. Raises InputError if it does not answer. Unknown lamp hours and faults are omitted."""
    with closing(_Link(projector)) as link:
        power = link.ask("POWR", "?")
        if not (power.isascii() and power.isdecimal() and int(power) < len(POWERS)):
            raise link.wrong("POWR", power)
        return Status(POWERS[int(power)], _hours(link.ask("LAMP", "?")), _faults(link.ask("ERST", "?")))


class _Link:
    """One connection, after the projector's greeting."""

    def __init__(self, projector: Projector) -> None:
        self._projector, self._arrived = projector, b""
        try:
            self._socket = socket.create_connection((projector.host, projector.port), ANSWER_S)
        except OSError as error:
            raise self._failed(error) from None
        try:
            self._prefix = self._greeted(self._line())
        except BaseException:
            self.close()
            raise

    def ask(self, command: str, value: str) -> str:
        """Return the answer to `%1COMMAND value`: the text after the equals sign."""
        self._send(f"{self._prefix}%1{command} {value}\r")
        self._prefix = ""  # only the first command carries the digest
        answer = self._line()
        if answer.upper() == "PJLINK ERRA":
            raise InputError(f"projector {self._projector}: the password is wrong; correct it")
        head, equals, told = answer.partition("=")
        if not equals or head.upper() != f"%1{command}":
            raise self.wrong(command, answer)
        return told.strip()

    def wrong(self, command: str, answer: str) -> InputError:
        why = REFUSALS.get(answer, f"it answers {one_line(answer, 40)!r}")
        return InputError(f"projector {self._projector}: {command}: {why}; look at the projector")

    def close(self) -> None:
        self._socket.close()

    def _greeted(self, greeting: str) -> str:
        """Return the prefix of the first command."""
        words = greeting.split()
        if words == ["PJLINK", "0"]:
            return ""
        if words[:2] != ["PJLINK", "1"] or len(words) != 3:
            raise InputError(
                f"projector {self._projector}: no PJLink projector ({one_line(greeting, 40)!r}); check its address"
            )
        if not self._projector.password:
            raise InputError(f"projector {self._projector}: it asks for a password; give it one")
        return hashlib.md5((words[2] + self._projector.password).encode(), usedforsecurity=False).hexdigest()

    def _send(self, text: str) -> None:
        try:
            self._socket.sendall(text.encode())
        except OSError as error:
            raise self._failed(error) from None

    def _line(self) -> str:
        while b"\r" not in self._arrived and len(self._arrived) <= LONGEST_LINE:
            try:
                piece = self._socket.recv(LONGEST_LINE)
            except OSError as error:
                raise self._failed(error) from None
            if not piece:
                raise self._failed(ConnectionResetError("it ended the connection"))
            self._arrived += piece
        line, _, self._arrived = self._arrived.partition(b"\r")
        return line[:LONGEST_LINE].decode("ascii", errors="replace").strip()

    def _failed(self, error: OSError) -> InputError:
        reason = "no answer" if isinstance(error, TimeoutError) else error.strerror or str(error)
        address = f"{self._projector.host}:{self._projector.port}"
        return InputError(
            f"projector {address}: {reason}; check its address, and that it may be switched on by the network"
        )


def _hours(answer: str) -> tuple[int, ...]:
    """Parse `1234 1 56 0` -> (1234, 56). Each lamp has its hours and whether it is on."""
    words = answer.split()
    if len(words) % 2 or not all(word.isascii() and word.isdecimal() and len(word) < 9 for word in words):
        return ()
    return tuple(map(int, words[::2]))


def _faults(answer: str) -> tuple[str, ...]:
    if len(answer) != len(PARTS) or set(answer) - set("012"):
        return ()
    return tuple(f"{part}: {STATES[int(digit)]}" for part, digit in zip(PARTS, answer, strict=True) if digit != "0")


# time between two queries of a projector: while it is on or off, and while it warms up or cools down
LOOK_S, AGAIN_S = 60.0, 5.0


class Lamps:
    """Switches and queries projectors, each in its own thread."""

    def __init__(self, projectors: Sequence[Projector]) -> None:
        self._lamps = [_Lamp(projector) for projector in projectors]

    def told(self) -> list[dict[str, Any]]:
        """Return each projector's address, power (of POWERS, null if unknown), lamp hours, faults and trouble."""
        return [lamp.told() for lamp in self._lamps]

    def __len__(self) -> int:
        return len(self._lamps)

    def switch(self, number: int | None, *, on: bool) -> None:
        """Order projectors to be switched.

        number : number of the projector, from 0; None for all.
        on : whether to switch on.
        """
        for lamp in self._lamps if number is None else [self._lamps[number]]:
            lamp.switch(on)

    def close(self) -> None:
        for lamp in self._lamps:
            lamp.close()


class _Lamp:
    def __init__(self, projector: Projector) -> None:
        self._projector = projector
        self._status: Status | None = None
        self._trouble: str | None = None
        self._wanted: bool | None = None
        self._awake = threading.Event()
        self._closed = False
        threading.Thread(target=self._run, name=f"lamp {projector}", daemon=True).start()

    def told(self) -> dict[str, Any]:
        known = self._status
        return {
            "address": str(self._projector),
            "power": None if known is None else known.power,
            "lamp-hours": [] if known is None else list(known.lamp_hours),
            "faults": [] if known is None else list(known.faults),
            "trouble": self._trouble,
        }

    def switch(self, on: bool) -> None:
        self._wanted = on
        self._awake.set()

    def close(self) -> None:
        self._closed = True
        self._awake.set()

    def _run(self) -> None:
        while not self._closed:
            self._awake.clear()
            try:
                self._look()
                self._trouble = None
            except InputError as error:
                self._status, self._trouble = None, str(error).removeprefix(f"projector {self._projector}: ")
            settled = self._wanted is None and self._status is not None and self._status.settled
            self._awake.wait(LOOK_S if settled else AGAIN_S)

    def _look(self) -> None:
        """Query the projector, and send the order that is still missing."""
        self._status, wanted = status_of(self._projector), self._wanted
        if wanted is not None and self._status.settled:
            if self._status.power != POWERS[wanted]:
                switch(self._projector, on=wanted)
                self._status = status_of(self._projector)
            if self._wanted is wanted:
                self._wanted = None

"""Network projector after JBMIA's specification of PJLink class 1: a server with a simulated lamp."""

import hashlib
import secrets
import socketserver
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

OFF, ON, COOLING, WARMING = range(4)
NO_COMMAND, NO_VALUE, NOT_NOW, FAILED = (f"ERR{n}" for n in range(1, 5))


class Lamp:
    """State of a projector.

    slow : status queries until it is warm or cool.
    password : "" for none.
    answers : replaces the projector's own answers.
    heard : every command and its answer.
    lines : lines as received.
    """

    def __init__(self, *, power: int = OFF, slow: int = 0, password: str = "", erst: str = "000000") -> None:
        self.power, self.slow, self.password, self.erst = power, slow, password, erst
        self.hours = [1234]
        self.answers: dict[str, str] = {}
        self.greeting: str | None = None
        self.heard: list[tuple[str, str]] = []
        self.lines: list[str] = []
        self.port = 0
        self._wait = 0
        self._lock = threading.Lock()

    def answer(self, command: str, value: str) -> str:
        with self._lock:
            found = self.answers.get(command) or self._answer(command, value)
            self.heard.append((f"{command} {value}", found))
            return found

    def _answer(self, command: str, value: str) -> str:
        if command == "POWR" and value == "?":
            return self._look()
        if command == "POWR" and value in ("0", "1"):
            return self._switch(ON if value == "1" else OFF)
        if command == "POWR":
            return NO_VALUE
        if value != "?":
            return NO_VALUE if command in ("LAMP", "ERST", "NAME") else NO_COMMAND
        known = {
            "LAMP": " ".join(f"{hours} {int(self.power == ON)}" for hours in self.hours),
            "ERST": self.erst,
            "NAME": "left",
        }
        return known.get(command, NO_COMMAND)

    def _look(self) -> str:
        if self.power in (COOLING, WARMING):
            self._wait -= 1
            if self._wait < 0:
                self.power = OFF if self.power == COOLING else ON
        return str(self.power)

    def _switch(self, power: int) -> str:
        if self.power in (COOLING, WARMING):
            return NOT_NOW
        if self.power != power:
            self.power, self._wait = (WARMING if power == ON else COOLING), self.slow
        return "OK"

    def count(self, command: str) -> int:
        return sum(heard == command for heard, _ in self.heard)


class _Connection(socketserver.StreamRequestHandler):
    timeout = 30

    def handle(self) -> None:
        lamp: Lamp = self.server.lamp  # type: ignore[attr-defined]
        seed = secrets.token_hex(4)
        self._say(lamp.greeting or (f"PJLINK 1 {seed}" if lamp.password else "PJLINK 0"))
        trusted = not lamp.password
        digest = hashlib.md5((seed + lamp.password).encode()).hexdigest()
        while (line := self._line()) is not None:
            lamp.lines.append(line)
            if not trusted:
                if not line.startswith(digest):
                    self._say("PJLINK ERRA")
                    return
                trusted, line = True, line.removeprefix(digest)
            command, _, value = line.removeprefix("%1").partition(" ")
            if not line.startswith("%1") or len(command) != 4:
                return
            self._say(f"%1{command}={lamp.answer(command, value)}")

    def _say(self, line: str) -> None:
        self.wfile.write(f"{line}\r".encode())

    def _line(self) -> str | None:
        line = bytearray()
        while (byte := self.rfile.read(1)) not in (b"\r", b""):
            line += byte
            if len(line) > 136 + 32:  # length of the longest command and a digest
                return None
        return line.decode() if byte else None


class _Server(socketserver.ThreadingTCPServer):
    allow_reuse_address = daemon_threads = True


@contextmanager
def projector(**kind: Any) -> Iterator[Lamp]:
    """Start a projector that listens at its `port` on this machine."""
    lamp = Lamp(**kind)
    with _Server(("127.0.0.1", 0), _Connection) as server:
        server.lamp = lamp  # type: ignore[attr-defined]
        lamp.port = server.server_address[1]
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
        thread.start()
        try:
            yield lamp
        finally:
            server.shutdown()
            thread.join()

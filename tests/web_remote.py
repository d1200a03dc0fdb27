"""A player with --remote and its visitors: WebSockets as a page opens them, and plain requests."""

import http.client
import json
import re
import socket
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from websockets.sync.client import connect
from websockets.typing import Subprotocol

from tests.desktop import playing
from tests.programs import PATIENCE_S, descendants, wait_until


def free_port(kind: socket.SocketKind = socket.SOCK_STREAM) -> int:
    """Return a port that is free now."""
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@dataclass(frozen=True)
class Place:
    """Address of a player's page."""

    port: int
    token: str

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.port}/#{self.token}"

    def get(self, path: str, method: str = "GET", **headers: str) -> tuple[int, dict[str, str], bytes]:
        """Return status, headers in lower case, and body."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=PATIENCE_S)
        try:
            connection.request(method, path, headers=headers)
            answer = connection.getresponse()
            return answer.status, {name.lower(): value for name, value in answer.getheaders()}, answer.read()
        finally:
            connection.close()

    def visit(self, **settings: Any) -> "Visitor":
        """Connect as the page does, by default with the right `token`, `host` and `origin`."""
        return Visitor(self, **settings)


class Visitor:
    """A WebSocket client: requests are answered, events and values are kept."""

    def __init__(self, place: Place, *, token: str | None = None, host: str = "", origin: str | None = None) -> None:
        words = "counterlight", place.token if token is None else token
        self._leave = ExitStack()
        connection = connect(
            f"ws://{host or '127.0.0.1'}:{place.port}/socket",
            sock=socket.create_connection(("127.0.0.1", place.port), PATIENCE_S),
            subprotocols=[Subprotocol(word) for word in words],
            origin=origin,  # type: ignore[arg-type]
            open_timeout=PATIENCE_S,
            proxy=None,
        )
        self._socket = self._leave.enter_context(connection)
        self._number = 1000  # above the numbers that tests use
        self.values: dict[str, Any] = {}
        self.events: list[dict[str, Any]] = []

    def ask(self, *words: object) -> dict[str, Any]:
        self._number += 1
        self.send(json.dumps({"command": words, "request_id": self._number}))
        return self.answer(self._number)

    def answer(self, number: int) -> dict[str, Any]:
        """Return the answer to the request of that number; 0 for an answer without a number."""
        while True:
            heard = self.hear()
            if heard.get("request_id") == number:
                return heard

    def get(self, name: str) -> Any:
        answer = self.ask("get_property", name)
        assert answer["error"] == "success", answer
        return answer["data"]

    def send(self, message: str | bytes) -> None:
        self._socket.send(message)

    def hear(self) -> dict[str, Any]:
        """Receive the next message, and store events and values."""
        heard = dict(json.loads(self._socket.recv(timeout=PATIENCE_S)))
        if heard.get("event") == "properties":
            self.values |= heard["values"]
        elif "event" in heard:
            self.events.append(heard)
        return heard

    def hear_until(self, condition: Callable[[], bool]) -> None:
        while not condition():
            self.hear()

    def close(self) -> None:
        self._leave.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@contextmanager
def show_with_remote(display: str, folder: Path, *arguments: object) -> Iterator[tuple[Any, Place]]:
    """Run a player that has shown a frame. Its token is stored in `folder`."""
    port = free_port()
    options = "--no-config", "--no-audio", "--remote", port
    with playing(display, *arguments, *options, folder=folder, XDG_STATE_HOME=str(folder)) as process:
        kept = folder / "counterlight" / "remote-token"
        wait_until(lambda: kept.exists() and _listens(port), "the page", process)
        place = Place(port, kept.read_text())
        with place.visit() as visitor:
            wait_until(lambda: visitor.get("frames") > 0, "a frame", process)
        yield process, place


def printed_address(text: str) -> re.Match[str] | None:
    """Return port and token as the player prints them."""
    return re.search(r"^remote: http://[\w.:\[\]-]+:(\d+)/#([\w-]+)$", text, re.MULTILINE)


def child(pid: int, module: str) -> int:
    """Return the descendant of a process that runs a module."""
    heard = {each: Path(f"/proc/{each}/cmdline").read_bytes().split(b"\0") for each in descendants(pid)}
    (found,) = (each for each, words in heard.items() if module.encode() in words)
    return found


def _listens(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0

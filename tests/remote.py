"""Player in a window, and a client of its control socket."""

import json
import socket
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import Any, Self

from tests.desktop import ON_A_GPU, playing
from tests.programs import PATIENCE_S, wait_until

OF_A_BUSY_MACHINE = "not every frame can be shown in time", "watch: no camera: no capture for"  # notices of a show


def on_any_machine(notices: Iterable[str]) -> list[str]:
    """Return the notices that do not depend on how busy the machine is."""
    return [notice for notice in notices if not notice.startswith(OF_A_BUSY_MACHINE)]


class Client:
    """Connection to a player that answers requests and keeps events."""

    def __init__(self, path: Path) -> None:
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.settimeout(PATIENCE_S)
        self._socket.connect(str(path))
        self._lines = self._socket.makefile("rb")
        self._numbers = count(1)
        self.events: list[dict[str, Any]] = []

    def ask(self, *words: object) -> dict[str, Any]:
        number = next(self._numbers)
        self.send(json.dumps({"command": words, "request_id": number}).encode())
        answer = self.answer()
        assert answer["request_id"] == number
        return answer

    def get(self, name: str) -> Any:
        answer = self.ask("get_property", name)
        assert answer["error"] == "success", answer
        return answer["data"]

    def send(self, line: bytes) -> None:
        self._socket.sendall(line + b"\n")

    def answer(self) -> dict[str, Any]:
        while True:
            line = self._lines.readline()
            assert line, "closed"
            message = dict(json.loads(line))
            if "error" in message:
                return message
            self.events.append(message)

    def ending(self) -> list[str]:
        """Names of the events until the player closes the connection."""
        return [json.loads(line).get("event") for line in self._lines]

    def close(self) -> None:
        self._lines.close()
        self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@contextmanager
def show(
    display: str, folder: Path, *arguments: object, how: tuple[str, ...] = ON_A_GPU
) -> Iterator[tuple[Any, Client]]:
    """Start a player; yield its process and a client after the first frame."""
    path = folder / "show.socket"
    options = "--no-config", "--no-audio", "--control", path
    with playing(display, *arguments, *options, folder=folder, how=how) as process:
        wait_until(path.exists, "the socket", process)
        client = Client(path)
        try:
            wait_until(lambda: client.get("frames") > 0, "a frame", process)
            yield process, client
        finally:
            client.close()

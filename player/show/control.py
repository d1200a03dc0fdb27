"""The control socket: JSON lines over a Unix socket, in the manner of mpv's IPC (docs/unattended.md).

    in    {"command": ["set_property", "pause", true], "request_id": 7}
    out   {"request_id": 7, "error": "success", "data": null}
    out   {"event": "property-change", "id": 1, "name": "pause", "data": true}

Served from the player's own loop: a poll never waits, takes a few milliseconds at most, and keeps a bounded number of
bytes for every client. Whoever does not read his answers is not read either until he does.
"""

import contextlib
import socket
import time
from pathlib import Path
from typing import Protocol

from counterlight.show.client import Client, Values
from counterlight.show.registry import Commands
from counterlight.unattended.listening import listen

MAX_CLIENTS = 16
POLL_S = 0.004  # a quarter of a frame at 60 Hz


class Remote(Protocol):
    """Somebody elsewhere who commands a show."""

    def poll(self, commands: Commands) -> None:
        """Answer what has arrived and tell what has changed; never waits."""

    def close(self) -> None: ...


class Clients:
    """Who is connected, and what plays as far as they have been told."""

    def __init__(self) -> None:
        self._clients: list[Client] = []
        self._count = 0
        self._playing: object = None

    def __len__(self) -> int:
        return len(self._clients)

    def admit(self, connection: socket.socket) -> None:
        connection.setblocking(False)
        self._count += 1
        self._clients.append(Client(connection, f"ipc-{self._count}"))

    def poll(self, commands: Commands) -> None:
        """Answer what has arrived, tell what has changed, forget who has gone; never waits."""
        deadline = time.monotonic() + POLL_S
        for client in self._clients:
            client.receive(commands, deadline)
            if time.monotonic() > deadline:
                break
        self._clients = self._clients[1:] + self._clients[:1]  # nobody is always the last
        self._tell(commands)
        self._sweep()

    def close(self) -> None:
        """Say goodbye."""
        for client in self._clients:
            client.tell("shutdown")
            client.flush()
            client.close()
        self._clients = []

    def _tell(self, commands: Commands) -> None:
        if not self._clients:
            self._playing = None
            return
        known = Values(commands)
        playing = known["playlist-playing-pos"], known["path"]
        if self._playing not in (None, playing):
            for client in self._clients:
                client.tell("end-file")
                client.tell("start-file", path=playing[1])
        self._playing = playing
        for client in self._clients:
            client.tell_changes(known)

    def _sweep(self) -> None:
        for client in self._clients:
            client.flush()
        gone = [client for client in self._clients if client.gone]
        for client in gone:
            client.close()
            self._clients.remove(client)


class ControlServer:
    """Listens at `path`, which only this user may open. Raises InputError when somebody else already does."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._clients = Clients()
        self._socket = listen(path, MAX_CLIENTS)
        status = path.stat()
        self._inode = status.st_dev, status.st_ino

    def poll(self, commands: Commands) -> None:
        """Let in who has knocked, and serve everybody; never waits."""
        self._accept()
        self._clients.poll(commands)

    def close(self) -> None:
        """Say goodbye and remove the socket, unless another player has put its own there."""
        self._clients.close()
        self._socket.close()
        with contextlib.suppress(OSError):
            status = self._path.stat()
            if (status.st_dev, status.st_ino) == self._inode:
                self._path.unlink()

    def _accept(self) -> None:
        for _ in range(MAX_CLIENTS):
            try:
                connection, _ = self._socket.accept()
            except OSError:  # nobody, or no file descriptor left: the next poll tries again
                return
            if len(self._clients) >= MAX_CLIENTS:
                connection.close()
            else:
                self._clients.admit(connection)

"""The control socket: JSON lines over a Unix socket, modelled on mpv's IPC (docs/unattended.md).

    in    {"command": ["set_property", "pause", true], "request_id": 7}
    out   {"request_id": 7, "error": "success", "data": null}
    out   {"event": "property-change", "id": 1, "name": "pause", "data": true}

The player's own loop serves the socket. A poll never waits and takes a few milliseconds at most. Each client has a
bounded buffer. The socket reads nothing more from a client until the client has read its answers.
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
POLL_S = 0.004  # longest time per poll: a quarter of a frame at 60 Hz


class Remote(Protocol):
    """A source of commands outside the player's window."""

    def poll(self, commands: Commands) -> None:
        """Answer received requests and report changes. Never waits."""

    def close(self) -> None: ...


class Clients:
    """The connected clients, and the medium that was last announced to them."""

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
        """Answer received requests, report changes, and drop closed connections. Never waits."""
        deadline = time.monotonic() + POLL_S
        for client in self._clients:
            client.receive(commands, deadline)
            if time.monotonic() > deadline:
                break
        self._clients = self._clients[1:] + self._clients[:1]  # rotates, so that no client is always served last
        self._tell(commands)
        self._sweep()

    def close(self) -> None:
        """Send the event `shutdown` to every client and close the connections."""
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
    """Listens at `path`, which only this user may open. Raises InputError if another process already listens there."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._clients = Clients()
        self._socket = listen(path, MAX_CLIENTS)
        status = path.stat()
        self._inode = status.st_dev, status.st_ino

    def poll(self, commands: Commands) -> None:
        """Accept new connections and serve all clients. Never waits."""
        self._accept()
        self._clients.poll(commands)

    def close(self) -> None:
        """Close all connections and remove the socket file, unless another player has replaced the file."""
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
            except OSError:  # no connection, or no file descriptor left: the next poll tries again
                return
            if len(self._clients) >= MAX_CLIENTS:
                connection.close()
            else:
                self._clients.admit(connection)

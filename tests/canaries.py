"""Detects forbidden access: inotify reports each opening of a file, and a port queues each connection."""

import ctypes
import os
import socket
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_LIBC = ctypes.CDLL(None, use_errno=True)
_OPENED, _MODIFIED = 0x20, 0x2  # inotify(7)
_EVENT = struct.Struct("iIII")


class Canary:
    """Watched files and a TCP port; `touched` names the files opened and the port called since the last look."""

    def __init__(self) -> None:
        self._inotify = _LIBC.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
        assert self._inotify >= 0
        self._names: dict[int, str] = {}
        self._socket = socket.create_server(("127.0.0.1", 0))
        self._socket.setblocking(False)
        self.port = self._socket.getsockname()[1]

    def watch(self, path: Path) -> Path:
        """Report every opening of this file from now on."""
        number = _LIBC.inotify_add_watch(self._inotify, os.fsencode(path), _OPENED | _MODIFIED)
        assert number >= 0, os.strerror(ctypes.get_errno())
        self._names[number] = path.name
        return path

    def touched(self) -> set[str]:
        return self._files() | self._callers()

    def close(self) -> None:
        os.close(self._inotify)
        self._socket.close()

    def _files(self) -> set[str]:
        try:
            data = os.read(self._inotify, 1 << 16)
        except BlockingIOError:
            return set()
        found, at = set(), 0
        while at < len(data):
            number, _, _, length = _EVENT.unpack_from(data, at)
            found.add(self._names[number])
            at += _EVENT.size + length
        return found

    def _callers(self) -> set[str]:
        try:
            connection, _ = self._socket.accept()
        except BlockingIOError:
            return set()
        connection.close()
        return {"port"}


@contextmanager
def canary() -> Iterator[Canary]:
    bird = Canary()
    try:
        yield bird
    finally:
        bird.close()

"""The supervisor's end of an anonymous pair of sockets, on which only its player can send messages."""

import socket
from contextlib import suppress
from types import TracebackType
from typing import Self

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

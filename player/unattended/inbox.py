"""Where a supervisor hears its player: a pair of sockets without a name. Nobody else is heard, and nothing is left."""

import socket
from contextlib import suppress
from types import TracebackType
from typing import Self

INHERITED = "fd:"  # of heartbeat.Notifier's addresses: the number of a socket that its process was given follows
MOST = 64  # messages a look: whoever never stops is not listened to for ever


class Inbox:
    """Messages of sd_notify(3) from one process, which is to inherit `theirs` and find `address` in NOTIFY_SOCKET."""

    def __init__(self) -> None:
        self._ours, self._theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._ours.setblocking(False)
        self.theirs = self._theirs.fileno()
        self.address = f"{INHERITED}{self.theirs}"

    def handed_over(self) -> None:
        """The process has been started."""
        self._theirs.close()

    def fileno(self) -> int:
        return self._ours.fileno()

    def drain(self) -> dict[str, str]:
        """The variables told since the last call, the newest of each."""
        told: dict[str, str] = {}
        with suppress(OSError):  # nothing more, or the process has gone
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

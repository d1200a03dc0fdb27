"""Where a supervisor hears its player: a datagram socket without a file, so that nothing is left of it."""

import socket
import struct
import sys
import tempfile
from contextlib import ExitStack, suppress
from pathlib import Path
from types import TracebackType
from typing import Self

_CREDENTIALS = struct.Struct("3i")  # pid, uid and gid of who has sent a message, as the kernel tells (unix(7))


class Inbox:
    """Messages of sd_notify(3).  address : for NOTIFY_SOCKET.

    On Linux its name is an abstract one, which everybody may write to: what others have sent is thrown away. Elsewhere
    it is a file in a folder of ours.
    """

    def __init__(self) -> None:
        self._stack = ExitStack()
        self._socket = self._stack.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM))
        self._socket.setblocking(False)
        if sys.platform == "linux":
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_PASSCRED, 1)
            self._socket.bind("")  # the kernel finds a name
            self.address = "@" + self._socket.getsockname()[1:].decode()
        else:
            folder = self._stack.enter_context(tempfile.TemporaryDirectory(prefix="counterlight-"))
            self.address = str(Path(folder, "notify"))
            self._socket.bind(self.address)

    def fileno(self) -> int:
        return self._socket.fileno()

    def drain(self, pid: int) -> dict[str, str]:
        """The variables that a process has told since the last call, the newest of each."""
        told: dict[str, str] = {}
        with suppress(BlockingIOError):
            while True:
                message, ancillary, _, _ = self._socket.recvmsg(1 << 16, socket.CMSG_SPACE(_CREDENTIALS.size))
                senders = [_CREDENTIALS.unpack(data)[0] for _, _, data in ancillary]
                lines = message.decode(errors="replace").splitlines() if senders in ([], [pid]) else []
                told |= dict(line.split("=", 1) for line in lines if "=" in line)
        return told

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, _: TracebackType | None) -> None:
        self._stack.close()

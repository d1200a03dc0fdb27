"""A Unix socket to listen at: ours alone, in place of a dead one, never of a live one."""

import errno
import os
import socket
import stat
from pathlib import Path

from player.errors import InputError


def listen(path: Path, backlog: int) -> socket.socket:
    """A socket bound to `path` with rights for this user alone, in place of what a dead player left there.

    Raises InputError where somebody listens, where something else lies, and where the system refuses.
    """
    _make_room(path)
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        os.fchmod(listener.fileno(), 0o600)  # Linux gives the file these rights from its first moment
        listener.bind(str(path))
        path.chmod(0o600)
        listener.listen(backlog)
        listener.setblocking(False)
    except OSError as error:
        listener.close()
        reason = error.strerror or str(error)
        raise InputError(
            f"{path}: no control socket can be made here ({reason}); use a short path in a folder of your own"
        ) from None
    return listener


def _make_room(path: Path) -> None:
    try:
        if not stat.S_ISSOCK(path.lstat().st_mode):
            raise InputError(f"{path}: not a socket; remove it, or give --control another path")
    except FileNotFoundError:
        return
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}; give --control another path") from None
    if _is_alive(path):
        raise InputError(f"{path}: another player is listening here; end it, or give --control another path")
    path.unlink(missing_ok=True)


def _is_alive(path: Path) -> bool:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.setblocking(False)
        try:
            code = probe.connect_ex(str(path))
        except OSError:  # a path that no socket can have
            return False
    return code not in (errno.ECONNREFUSED, errno.ENOENT)

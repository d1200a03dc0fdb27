"""Listens at a Unix socket for this user alone. Replaces a dead player's socket, never a live player's."""

import errno
import os
import re
import socket
import stat
from contextlib import suppress
from pathlib import Path

from counterlight.errors import InputError

MAX_ADDRESS = 107  # bytes of a socket path on Linux; other systems allow a few bytes less
_UNBORN = re.compile(r"\.([0-9a-f]{1,7})\.new")  # a socket that does not listen yet; the digits are its process


def listen(path: Path, backlog: int) -> socket.socket:
    """Return a socket that listens at `path`, with access for this user only. Replaces a dead player's socket.

    The path appears only once the socket listens, so that every client that sees it can connect. Raises InputError if
    another process listens there, if a file is in the way, or if the system refuses.
    """
    _make_room(path)
    unborn = path.with_name(f".{os.getpid():x}.new")
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        if len(os.fsencode(path)) > MAX_ADDRESS:  # clients could not connect to so long a path
            raise OSError(errno.ENAMETOOLONG, os.strerror(errno.ENAMETOOLONG))
        os.fchmod(listener.fileno(), 0o600)  # Linux gives the file these rights from its first moment
        listener.bind(str(unborn))
        unborn.chmod(0o600)
        listener.listen(backlog)
        listener.setblocking(False)
        os.link(unborn, path)  # unlike a rename, a link never replaces another file
    except FileExistsError:
        listener.close()
        raise InputError(f"{path}: another player has begun to listen here; end it, or give another path") from None
    except OSError as error:
        listener.close()
        reason = error.strerror or str(error)
        raise InputError(
            f"{path}: no control socket can be made here ({reason}); use a short path in a folder of your own"
        ) from None
    finally:
        with suppress(OSError):
            unborn.unlink(missing_ok=True)
    return listener


def _make_room(path: Path) -> None:
    """Remove the sockets of dead players."""
    with suppress(OSError):
        for match in filter(None, map(_UNBORN.fullmatch, os.listdir(path.parent))):
            leftover = path.with_name(match[0])
            if stat.S_ISSOCK(leftover.lstat().st_mode) and not _is_running(int(match[1], 16)):
                leftover.unlink(missing_ok=True)
    try:
        if not stat.S_ISSOCK(path.lstat().st_mode):
            raise InputError(f"{path}: not a socket; remove it, or give --control another path")
        if _is_alive(path):
            raise InputError(f"{path}: another player is listening here; end it, or give --control another path")
        path.unlink(missing_ok=True)
    except FileNotFoundError:
        return
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}; give --control another path") from None


def _is_running(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:  # a process of another user
        return True
    return True


def _is_alive(path: Path) -> bool:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.setblocking(False)
        try:
            code = probe.connect_ex(str(path))
        except OSError:  # no socket can have this path
            return False
    return code not in (errno.ECONNREFUSED, errno.ENOENT)

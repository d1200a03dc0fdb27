"""System calls that make files durable, swap them, and lock them for one process."""

import ctypes
import errno
import fcntl
import os
from functools import cache
from pathlib import Path
from typing import Any

_HERE = -100  # AT_FDCWD: paths are relative to the working folder
_EXCHANGE = 2  # RENAME_EXCHANGE
_UNKNOWN = (errno.ENOSYS, errno.EINVAL, errno.EOPNOTSUPP)  # errors of systems without exchange, such as NFS


def flush(path: Path) -> None:
    """Force a file or folder to disk. Raises OSError with the path if the disk refuses."""
    handle = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(handle)
    except OSError as error:  # the system's error does not contain the path
        if error.errno != errno.EINVAL or not path.is_dir():  # some file systems have no fsync for folders
            raise OSError(error.errno, error.strerror, str(path)) from None
    finally:
        os.close(handle)


def flush_tree(folder: Path) -> None:
    """Force a folder and everything below it to disk."""
    for path in (*folder.rglob("*"), folder):
        flush(path)


def move(source: Path, target: Path) -> None:
    """Rename a file or folder durably. A file at `target` is replaced in the same step."""
    os.rename(source, target)
    flush(target.parent)
    if source.parent != target.parent:
        flush(source.parent)


def exchange(one: Path, other: Path) -> bool:
    """Swap two names in one step, durably. Returns False if the system has no such step."""
    if not _exchange(one, other):
        return False
    flush(one.parent)
    flush(other.parent)
    return True


def _exchange(one: Path, other: Path) -> bool:
    call = _renameat2()
    if call is None:
        return False
    if call(_HERE, os.fsencode(one), _HERE, os.fsencode(other), _EXCHANGE) == 0:
        return True
    code = ctypes.get_errno()
    if code in _UNKNOWN:
        return False
    raise OSError(code, os.strerror(code), str(other))


@cache
def _renameat2() -> Any:
    """Return the C library's function, None if it has none."""
    return getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)


def lock(handle: int) -> bool:
    """Lock an open file until it is closed or its process dies. Returns False if another process holds the lock."""
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True

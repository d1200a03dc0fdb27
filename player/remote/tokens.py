"""The token that lets a browser command the show. It is created once and stored, so that a bookmark stays valid."""

import os
import re
import secrets
import stat
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from counterlight.errors import InputError

BYTES = 16  # random bytes, too many to guess
LONGEST = 1000  # bytes read from the file
_WORD = re.compile(r"[\w-]{20,200}", re.ASCII)


def default_path(environment: Mapping[str, str], home: Path) -> Path:
    """Return the path of the token by the XDG Base Directory Specification."""
    return Path(environment.get("XDG_STATE_HOME") or home / ".local" / "state") / "counterlight" / "remote-token"


def token_at(path: Path) -> str:
    """Return the token stored at `path`. Creates it if there is none.

    Raises InputError if another user could have read or written the file.
    """
    try:
        try:
            return _read(path)
        except FileNotFoundError:
            _make(path)
            return _read(path)
    except OSError as error:
        raise InputError(
            f"{path}: the remote's token cannot be kept here ({error.strerror}); set XDG_STATE_HOME to your own folder"
        ) from None


def _make(path: Path) -> None:
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    unborn = path.with_name(f".{path.name}.{os.getpid():x}")
    descriptor = os.open(unborn, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
    try:
        with os.fdopen(descriptor, "w") as file:
            file.write(secrets.token_urlsafe(BYTES))
        with suppress(FileExistsError):  # another player has just created it
            os.link(unborn, path)  # unlike a rename, a link never replaces another file
    finally:
        unborn.unlink()


def _read(path: Path) -> str:
    descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode) or status.st_uid != os.geteuid() or status.st_mode & 0o077:
            raise InputError(f"{path}: not a file that only this user can read; remove it, and a new token is made")
        word = os.read(descriptor, LONGEST).decode(errors="replace").strip()
    finally:
        os.close(descriptor)
    if not _WORD.fullmatch(word):
        raise InputError(f"{path}: holds no token; remove it, and a new one is made")
    return word

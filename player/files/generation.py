"""Reads a folder that another process may replace at any time, so that all data is of one generation."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from counterlight.errors import InputError
from counterlight.writing.stage import finish

ATTEMPTS = 10

T = TypeVar("T")


def read_steadily(manifest: Path, read: Callable[[], T]) -> T:
    """Return the result of `read` if the folder stayed the same during the call; otherwise read again.

    Completes a killed process's move first. Raises an exception of `read` if the folder stayed the same.

    manifest : the file of the folder that is written last, and so differs between generations.
    read : reads the folder.
    """
    for _ in range(ATTEMPTS):
        finish(manifest.parent)
        before = _identity(manifest)
        try:
            result = read()
        except InputError:
            if _identity(manifest) == before:
                raise
            continue
        if _identity(manifest) == before:
            return result
    raise InputError(f"{manifest.parent}: was replaced {ATTEMPTS} times while it was read; try again when that ends")


def _identity(path: Path) -> tuple[int, ...] | None:
    """Return values that no two files at this path share. Inode numbers are reused, but times are not."""
    try:
        status = os.stat(path)
    except OSError:
        return None
    return status.st_dev, status.st_ino, status.st_ctime_ns, status.st_mtime_ns, status.st_size

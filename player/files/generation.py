"""Reading what another process may replace meanwhile: everything of one generation, or again."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from counterlight.errors import InputError
from counterlight.writing.stage import finish

ATTEMPTS = 10

T = TypeVar("T")


def read_steadily(manifest: Path, read: Callable[[], T]) -> T:
    """What `read` returns if the folder of `manifest` is the same when it ends as when it began; else it reads again.

    manifest : the file of the folder that is written last, so that no two generations share it.
    Raises what `read` raises if that is not because the folder was replaced. What a killed process had begun to put
    there is completed first.
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
    """What no two files have that were ever at a path: numbers of files are used again, times are not."""
    try:
        status = os.stat(path)
    except OSError:
        return None
    return status.st_dev, status.st_ino, status.st_ctime_ns, status.st_mtime_ns, status.st_size

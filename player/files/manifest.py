"""Checksums of files, TOML output, and reading a folder that another process may replace at any time."""

import hashlib
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypeVar

import tomli_w

from counterlight.errors import InputError
from counterlight.writing.stage import finish


def sha256_of(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def describe_files(folder: Path) -> dict[str, dict[str, Any]]:
    """Return size and SHA-256 of every file below `folder`, by relative POSIX path, for `DescribedFiles`."""
    paths = [path for path in sorted(folder.rglob("*")) if path.is_file()]
    with ThreadPoolExecutor(os.cpu_count()) as threads:  # hashing releases the GIL
        return {
            path.relative_to(folder).as_posix(): {"bytes": path.stat().st_size, "sha256": checksum}
            for path, checksum in zip(paths, threads.map(sha256_of, paths), strict=True)
        }


def write_toml(path: Path, table: dict[str, Any]) -> None:
    path.write_text(tomli_w.dumps(table), encoding="utf-8")


ATTEMPTS = 10

T = TypeVar("T")


def read_steadily(manifest: Path, read: Callable[[], T]) -> T:
    """Return the result of `read` if the folder stayed the same during the call; otherwise read again.

    Completes a killed process's move first. Raises an exception of `read` if the folder stayed the same.

    manifest : the file of the folder that is written last; it differs after every change.
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
    """Return numbers that identify a file at a path. Inode numbers are reused, but times are not."""
    try:
        status = os.stat(path)
    except OSError:
        return None
    return status.st_dev, status.st_ino, status.st_ctime_ns, status.st_mtime_ns, status.st_size

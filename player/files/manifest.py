"""Checksums of files, and TOML output."""

import hashlib
import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import tomli_w


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

"""Files that are what they were described to be: checksums, and TOML."""

import hashlib
import tomllib
from pathlib import Path
from typing import Any

import tomli_w

from player.errors import InputError

MAX_TOML_BYTES = 4 << 20


def sha256_of(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def describe_files(folder: Path) -> dict[str, dict[str, Any]]:
    """Size and SHA-256 of every file below `folder`, by relative POSIX path: what `check_file` compares with."""
    return {
        path.relative_to(folder).as_posix(): {"bytes": path.stat().st_size, "sha256": sha256_of(path)}
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def check_file(folder: Path, name: str, described: dict[str, dict[str, Any]], fix: str) -> Path:
    """The path of `name` if it is, byte for byte, the file that was described; InputError ending in `fix` otherwise."""
    path = folder / name
    expected = described.get(name)
    if not isinstance(expected, dict):
        raise InputError(f"{folder}: its table of files does not list {name}; {fix}")
    if not path.is_file():
        raise InputError(f"{path}: missing; {fix}")
    size = path.stat().st_size
    if size != expected.get("bytes"):
        raise InputError(
            f"{path}: {size} bytes, expected {expected.get('bytes')}: the file is damaged or was replaced; {fix}"
        )
    if sha256_of(path) != expected.get("sha256"):
        raise InputError(
            f"{path}: its SHA-256 differs from the recorded one: the file is damaged or was replaced; {fix}"
        )
    return path


def write_toml(path: Path, table: dict[str, Any]) -> None:
    path.write_text(tomli_w.dumps(table), encoding="utf-8")


def read_toml(path: Path, fix: str) -> dict[str, Any]:
    """Parse a TOML file; InputError ending in `fix` when it is missing, too large or no TOML."""
    try:
        if path.stat().st_size > MAX_TOML_BYTES:
            raise InputError(f"{path}: {path.stat().st_size} bytes, at most {MAX_TOML_BYTES} are read; {fix}")
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"{path}: missing; {fix}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not valid TOML ({error}); {fix}") from None
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}; {fix}") from None

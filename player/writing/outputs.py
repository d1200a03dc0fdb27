"""Checks outputs before any work. Raises InputError, in one line, for a forbidden or impossible output."""

import os
import stat
from collections.abc import Iterable, Iterator, Sequence
from fnmatch import fnmatchcase
from itertools import combinations
from pathlib import Path

from counterlight.errors import InputError
from counterlight.writing.numbered import number_of, sequence_at
from counterlight.writing.stage import finish, is_stage

# Folders that may only be replaced as a whole, recognised by two files or folders in each.
KEPT = {
    ("calibration.toml", "mask.png"): "calibration",
    ("session.toml", "captures"): "capture",
    ("session.toml", "captures_2"): "capture",
}


def check_file(path: Path, *, suffixes: Sequence[str] = (), inputs: Iterable[Path] = ()) -> None:
    """Check that `path` can be written as a file with one of the suffixes, and is no input of the command."""
    if suffixes and path.suffix.lower() not in suffixes:
        found = path.suffix or "a file without suffix"
        raise InputError(f"{path}: cannot write {found}; use {', '.join(suffixes)}")
    _check_parent(path)
    if path.exists() and not path.is_file():
        raise InputError(f"{path}: is {kind_of(path)}; name a file")
    _refuse_inputs(path, [path], inputs)


def check_sequence(pattern: Path, *, inputs: Iterable[Path] = ()) -> None:
    """Check that the files of `name%05d.png` can be written, and that no existing file among them is an input.

    A sequence that a killed command left half in place is completed first.
    """
    _check_parent(pattern)
    finish(pattern)
    sequence_at(pattern)
    covered = [path for path in pattern.parent.iterdir() if number_of(pattern.name, path.name) is not None]
    _refuse_inputs(pattern, covered, inputs)


def check_log(path: Path, *, inputs: Iterable[Path] = ()) -> None:
    """Check that JSON lines can be appended to `path`: a new file, an earlier log, a pipe or a device, and no input."""
    if not path.exists():
        _check_parent(path)
    elif path.is_dir():
        raise InputError(f"{path}: is a folder; name a file")
    elif path.is_file():
        with path.open("rb") as file:
            if file.read(1) not in (b"", b"{"):
                raise InputError(f"{path}: is no log that lines could be added to; name another file")
    _refuse_inputs(path, [path], inputs)


def check_folder(folder: Path, *, inputs: Iterable[Path] = ()) -> None:
    """Check that `folder` can be written as a folder, and contains no input."""
    refuse_irreplaceable(folder)
    real = real_path(folder)
    above = next((parent for parent in real.parents if parent.exists()), real)
    _check_parent(above / real.name)
    for given in inputs:
        if real == real_path(given) or real in real_path(given).parents:
            held = "" if real == real_path(given) else f"holds {given}, which "
            raise InputError(f"{folder}: would be replaced, and {held}is read; choose another folder")


def refuse_irreplaceable(folder: Path) -> None:
    """Raises InputError if `folder` is a file, or is or contains the current folder, which a shell would lose."""
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is {kind_of(folder)}; name a folder")
    real, current = real_path(folder), Path.cwd()
    if real == current or real in current.parents:
        what = "is" if real == current else "contains"
        raise InputError(f"{folder}: would be replaced, and {what} the current folder; name a folder inside it")


def check_apart(*outputs: Path | None) -> None:
    """Check that no output equals or contains another output."""
    for one, other in combinations([path for path in outputs if path is not None], 2):
        a, b = real_path(one), real_path(other)
        if a == b or a in b.parents or b in a.parents:
            raise InputError(f"{one}: would be overwritten by {other}; give each output a place of its own")


def is_vacant(folder: Path) -> bool:
    """Whether `folder` does not exist, or contains at most the stages of killed writers."""
    if not folder.exists():
        return True
    return folder.is_dir() and all(is_stage(path.name) for path in folder.iterdir())


def refuse_strangers(folder: Path, parts: Sequence[str], kind: str) -> None:
    """Check that `folder`, which will be replaced, contains only its parts.

    parts : names, or patterns such as *.png.
    kind : what the folder is, in words for the message.
    """
    for path in sorted(folder.iterdir()):
        if not (is_stage(path.name) or any(fnmatchcase(path.name, part) for part in parts)):
            raise InputError(f"{path}: is no part of {kind} and would be lost; move it out of {folder} first")


def kind_of(path: Path) -> str:
    """Return in words what an existing path is."""
    mode = path.stat().st_mode
    return "a folder" if stat.S_ISDIR(mode) else "a file" if stat.S_ISREG(mode) else "a device, a pipe or a socket"


def _check_parent(path: Path) -> None:
    parent = path.parent
    if not parent.exists():
        raise InputError(f"{parent}: no such folder; make it first")
    if not parent.is_dir():
        raise InputError(f"{parent}: is {kind_of(parent)}; choose a folder for {path.name}")
    if not os.access(parent, os.W_OK | os.X_OK):
        raise InputError(f"{parent}: cannot be written to; check its rights, or choose another folder for {path.name}")
    for folder in real_path(path).parents:
        for marks, kind in KEPT.items():
            if all((folder / mark).exists() for mark in marks):
                raise InputError(f"{path}: is inside the {kind} folder {folder}; choose a place outside")


def _refuse_inputs(output: Path, covered: Sequence[Path], inputs: Iterable[Path]) -> None:
    """Check that none of the files that `output` replaces is an input, under any name."""
    replaced = {_identity(path) for path in covered if path.exists()}
    for given in _files(inputs) if replaced else ():
        if _identity(given) in replaced:
            raise InputError(f"{output}: would overwrite {given}, which is read; choose another name for it")


def _identity(path: Path) -> tuple[int, int]:
    status = path.stat()
    return status.st_dev, status.st_ino


def _files(inputs: Iterable[Path]) -> Iterator[Path]:
    """Yield the inputs that exist, and the direct contents of input folders."""
    for path in inputs:
        if path.is_dir():
            yield from (entry for entry in path.iterdir() if entry.exists())
        elif path.exists():
            yield path


def real_path(path: Path) -> Path:
    return Path(os.path.realpath(path))

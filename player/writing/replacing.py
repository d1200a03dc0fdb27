"""Writes files, folders and numbered sequences completely or not at all. All commands write with these functions.

Each context is opened before the work that produces the result. It locks the name, and refuses an impossible output at
once. The old version stays until the block ends successfully.
"""

import errno
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from counterlight.errors import InputError
from counterlight.writing import disk, moves
from counterlight.writing.numbered import sequence_at
from counterlight.writing.outputs import kind_of, real_path, refuse_irreplaceable
from counterlight.writing.stage import Stage, clean_up, staged

# Errors that only writing can cause. They often do not contain a path.
_OF_WRITING = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


@contextmanager
def replacing_file(path: Path) -> Iterator[Path]:
    """Yield a path for the new file. On success the new file replaces `path`, otherwise it is removed.

    Raises InputError, naming `path`, if the system refuses (no such folder, no right, no space), if `path` is no file,
    or if another process is writing it.
    """
    target = real_path(path)
    with _refusals_named(path, target), staged(target) as stage:
        if target.exists() and not target.is_file():
            raise InputError(f"{path}: is {kind_of(target)}; name a file")
        yield stage.new / target.name
        moves.put_file(stage.folder, target)


@contextmanager
def replacing_folder(folder: Path, refuse: Callable[[Path], None] | None = None) -> Iterator[Path]:
    """Yield an empty folder. On success it replaces `folder` as a whole, otherwise it is removed.

    Raises InputError, naming `folder`, if the system refuses, or if another process is writing it or into it.

    refuse : raises InputError if `folder` must not be replaced; called before and after the work.
    """
    target = real_path(folder)  # a link is kept, and its target is replaced
    made = [parent for parent in target.parents if not parent.exists()]
    try:
        with _refusals_named(folder, target):
            _refuse_folder(folder, refuse)
            target.parent.mkdir(parents=True, exist_ok=True)
            with staged(target) as stage:
                _refuse_folder(folder, refuse)  # again, because it may have been completed just now
                if living := clean_up(target) if target.is_dir() else []:
                    busy = f"{living[0].writer()} is writing {living[0].target.name} in it"
                    raise InputError(f"{folder}: {busy}; wait until it has ended")
                yield stage.new
                _refuse_folder(folder, refuse)
                moves.put_folder(stage.folder, target)
    except BaseException:
        with suppress(OSError):
            for parent in made:
                parent.rmdir()
        raise


@contextmanager
def replacing_sequence(pattern: Path) -> Iterator[Path]:
    """Yield an empty folder for the files `name_of(pattern.name, 0)`, …; on success they replace the sequence.

    Raises InputError, naming `pattern`, if the system refuses, if another process is writing the sequence, or if the
    files that match the pattern are not numbered from 0.
    """
    target = real_path(pattern)
    with _refusals_named(pattern, target), staged(target) as stage:
        sequence_at(target)
        yield stage.new
        moves.put_sequence(stage.folder, target, sequence_at(target))


def remove_file(path: Path) -> None:
    """Remove a file durably, if it exists. Raises InputError with the file's name if the system refuses."""
    with _refusals_named(path, real_path(path)):
        path.unlink(missing_ok=True)
        disk.flush(path.parent)


@contextmanager
def holding(path: Path) -> Iterator[None]:
    """Lock the name `path`, so that no other process writes it. Creates its parent folders.

    Raises InputError if another process holds the name, or if the system refuses.
    """
    target = real_path(path)
    with _refusals_named(path, target):
        target.parent.mkdir(parents=True, exist_ok=True)
        with staged(target):
            yield


@contextmanager
def filling_folder(folder: Path) -> Iterator[Callable[[Path, bytes], None]]:
    """Lock an existing folder, and yield a function that writes a file into it, completely and durably."""
    target = real_path(folder)
    with _refusals_named(folder, target), staged(target) as stage:

        def put(path: Path, content: bytes) -> None:
            with _refusals_named(path, target):
                made = stage.new / path.name
                made.write_bytes(content)
                moves.put_file(stage.folder, target / path.name)

        yield put


@contextmanager
def _refusals_named(path: Path, target: Path) -> Iterator[None]:
    """Convert system errors about writing `path` into an InputError that names it.

    The work in the block may fail in other ways; those errors pass unchanged.
    """
    try:
        yield
    except OSError as error:
        if not _is_about(error, target):
            raise
        reason = error.strerror or " ".join(str(error).split())
        raise InputError(f"{path}: cannot be written ({reason}); check the folder, its rights and its space") from None


def _is_about(error: OSError, target: Path) -> bool:
    if error.errno in _OF_WRITING:
        return True
    names = (name for name in (error.filename, error.filename2) if isinstance(name, str | bytes))
    places = [Path(os.fsdecode(name).removeprefix("file:")) for name in names]  # FFmpeg names files in this form
    ours = (target, Stage(target).folder)
    return any(place in (*target.parents, *ours) or any(up in ours for up in place.parents) for place in places)


def _refuse_folder(folder: Path, refuse: Callable[[Path], None] | None) -> None:
    if refuse is not None:
        refuse(folder)
    refuse_irreplaceable(folder)

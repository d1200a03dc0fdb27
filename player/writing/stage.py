"""The hidden folder next to an output, in which the output is created and from which it is moved when complete.

    .NAME.counterlight-partial/pid     locked by the process that writes NAME; holds the process number
    .NAME.counterlight-partial/new     the new version

A name therefore has one writer at a time. A stage whose lock is free belongs to a dead process. The next writer in the
same folder completes the interrupted move (moves.py) and removes the rest.
"""

import os
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from counterlight.errors import InputError
from counterlight.writing import disk, moves

PID = "pid"
SUFFIX = ".counterlight-partial"
PATIENCE_S = 0.2  # longest wait for another process that cleans up
MOVING_S = 5.0  # longest wait for another process that moves files into place


@dataclass(frozen=True)
class Stage:
    """The place where `target` is created, on the same file system unless `target` is a mount point."""

    target: Path

    @property
    def folder(self) -> Path:
        return self.target.parent / f".{self.target.name}{SUFFIX}"

    @property
    def new(self) -> Path:
        return self.folder / moves.NEW

    @property
    def pid(self) -> Path:
        return self.folder / PID

    @property
    def is_interrupted(self) -> bool:
        return moves.is_interrupted(self.folder, self.target)

    def contents(self) -> list[Path]:
        """Return the stage's contents besides the lock."""
        return [path for name in moves.CONTENTS if (path := self.folder / name).exists()]

    def writer(self) -> str:
        """Return the process that holds the stage, in words."""
        with suppress(OSError):
            if text := self.pid.read_text(encoding="ascii", errors="replace").strip():
                return f"process {text}"
        return "another process"


@contextmanager
def staged(target: Path) -> Iterator[Stage]:
    """Lock the name `target` (a real path), and yield a stage with an empty folder `new`. Removes the stage at the end.

    Stages of dead processes in the same folder are completed or removed first. Raises InputError if another process is
    writing `target`, and OSError if the system refuses.
    """
    stage = Stage(target)
    handle = _hold(stage)
    try:
        _settle(stage)
        os.ftruncate(handle, 0)
        os.pwrite(handle, b"%d\n" % os.getpid(), 0)
        with suppress(OSError):  # the folder may be writable but not readable
            clean_up(target.parent)
        stage.new.mkdir()
        yield stage
    except KeyboardInterrupt as signalled:
        signalled.add_note("nothing half-written remains")
        raise
    finally:
        _remove(stage)
        os.close(handle)


def clean_up(folder: Path) -> list[Stage]:
    """Complete or remove the stages of dead processes in a folder. Returns the stages of living processes."""
    living = []
    for stage in _stages(folder):
        with suppress(OSError):  # another user's stage, or a disk error; the next writer tries again
            handle = _take(stage)
            if handle is None:
                living.append(stage)
            else:
                _bury(stage, handle)
    return living


def finish(target: Path) -> None:
    """Complete the move of a killed process to `target`, before reading it. Without such a move, costs one file access.

    Raises InputError if the move cannot be completed, or if another process takes longer than 5 s for it.
    """
    stage = Stage(Path(os.path.realpath(target)))
    deadline = time.monotonic() + MOVING_S
    try:
        while stage.is_interrupted:
            handle = _take(stage)
            if handle is not None:
                _bury(stage, handle)
            elif time.monotonic() >= deadline:
                raise InputError(f"{target}: {stage.writer()} is putting it in place; wait until it has ended")
            else:
                time.sleep(0.01)
    except OSError as error:
        raise InputError(
            f"{target}: a command that was killed left it half in place, and it cannot be completed "
            f"({error.strerror}); check the rights and the space of {target.parent}"
        ) from None


def is_stage(name: str) -> bool:
    """Whether a name belongs to a stage."""
    return name.startswith(".") and name.endswith(SUFFIX)


def _stages(folder: Path) -> Iterator[Stage]:
    """Yield the stages in a folder, of living and dead processes."""
    for name in filter(is_stage, os.listdir(folder)):
        stage = Stage(folder / name[1 : -len(SUFFIX)])
        if stage.folder.is_dir() and not stage.folder.is_symlink() and stage.pid.is_file():
            yield stage
        else:
            with suppress(OSError):  # an empty stage, whose creator was killed between its first two steps
                stage.folder.rmdir()


def _hold(stage: Stage) -> int:
    """Create the stage, or take over a dead process's stage. Returns the open lock."""
    deadline, ever_ours = time.monotonic() + PATIENCE_S, False
    while True:
        with suppress(FileExistsError):
            stage.folder.mkdir()
        if not _is_strange(stage):
            ever_ours = True
            handle = _take(stage, os.O_CREAT)
            if handle is not None:
                return handle
        if time.monotonic() >= deadline:
            if ever_ours:
                raise InputError(f"{stage.target}: {stage.writer()} is writing it; wait until it has ended")
            raise InputError(f"{stage.folder}: is in the way of writing {stage.target.name}; move it away")
        time.sleep(0.01)


def _take(stage: Stage, flags: int = 0) -> int | None:
    """Lock the stage. Returns None if another process holds it or it no longer exists."""
    try:
        handle = os.open(stage.pid, os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW | flags, 0o644)
    except FileNotFoundError:
        return None
    held = False
    try:
        held = disk.lock(handle) and os.path.samestat(os.fstat(handle), os.stat(stage.pid))
    except FileNotFoundError:
        pass
    finally:
        if not held:
            os.close(handle)
    return handle if held else None


def _is_strange(stage: Stage) -> bool:
    """Whether something other than a stage has the stage's name. A stage may also be in the middle of its removal."""
    folder = stage.folder
    if folder.is_symlink() or not folder.is_dir():
        return True
    with suppress(FileNotFoundError):
        return any(folder.iterdir()) and not stage.pid.is_file()
    return True


def _bury(stage: Stage, handle: int) -> None:
    """Complete and remove a dead process's stage, whose lock is already held."""
    try:
        _settle(stage)
        _remove(stage)
    finally:
        os.close(handle)


def _settle(stage: Stage) -> None:
    """Complete an interrupted move, and empty the stage."""
    if stage.is_interrupted:
        moves.complete(stage.folder, stage.target)
    for path in stage.contents():
        shutil.rmtree(path)


def _remove(stage: Stage) -> None:
    """Remove a held stage, unless an interrupted move still needs it. The next writer then tries again."""
    if stage.is_interrupted:
        return
    for path in stage.contents():
        shutil.rmtree(path, ignore_errors=True)
    if not stage.contents():
        with suppress(OSError):
            stage.pid.unlink()
            stage.folder.rmdir()

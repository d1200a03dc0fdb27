"""The hidden folder beside what is being written, in which everything is made and from which it is moved when whole.

    .NAME.counterlight-partial/pid     locked by the process that writes NAME, as long as it lives; holds its number
    .NAME.counterlight-partial/new     what it makes

So a name has one writer at a time, and what a dead one left is known: nobody holds its lock. Whoever next writes
anything into the same folder completes what was begun (moves.py) and removes the rest.
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
PATIENCE_S = 0.2  # for somebody who is just cleaning up
MOVING_S = 5.0  # for somebody who is just putting things in place


@dataclass(frozen=True)
class Stage:
    """Where `target` is made. Its folder has the target's file system, unless the target is one by itself."""

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
        """What it holds beside the lock."""
        return [path for name in moves.CONTENTS if (path := self.folder / name).exists()]

    def writer(self) -> str:
        """Who holds it."""
        with suppress(OSError):
            if text := self.pid.read_text(encoding="ascii", errors="replace").strip():
                return f"process {text}"
        return "another process"


@contextmanager
def staged(target: Path) -> Iterator[Stage]:
    """Hold the name `target` (a real path) while it is made in `stage.new`, an empty folder, removed at the end.

    What dead processes left in the same folder is completed or removed first. Raises InputError where another process
    is writing `target`, and OSError where the system refuses.
    """
    stage = Stage(target)
    handle = _hold(stage)
    try:
        _settle(stage)
        os.ftruncate(handle, 0)
        os.pwrite(handle, b"%d\n" % os.getpid(), 0)
        with suppress(OSError):  # a folder that may be written to, but not be listed
            clean_up(target.parent)
        stage.new.mkdir()
        yield stage
    finally:
        _remove(stage)
        os.close(handle)


def clean_up(folder: Path) -> list[Stage]:
    """Complete or remove what dead processes left in a folder; returns what living ones are making there."""
    living = []
    for stage in _stages(folder):
        with suppress(OSError):  # somebody else's, or a disk that refuses: the next one tries again
            handle = _take(stage)
            if handle is None:
                living.append(stage)
            else:
                _bury(stage, handle)
    return living


def finish(target: Path) -> None:
    """Complete what a killed process had begun to put at `target`: for readers. Costs a look where there is nothing.

    Raises InputError where that is not possible, or where somebody takes longer than 5 s to put it there.
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
    """Whether a file of this name is what writers make, and leave when they are killed."""
    return name.startswith(".") and name.endswith(SUFFIX)


def _stages(folder: Path) -> Iterator[Stage]:
    """Those in a folder, whether living or dead."""
    for name in filter(is_stage, os.listdir(folder)):
        stage = Stage(folder / name[1 : -len(SUFFIX)])
        if stage.folder.is_dir() and not stage.folder.is_symlink() and stage.pid.is_file():
            yield stage
        else:
            with suppress(OSError):  # one whose maker was killed between its first two steps is empty
                stage.folder.rmdir()


def _hold(stage: Stage) -> int:
    """Make the stage, or take over a dead one's; returns the open lock."""
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
    """The stage's lock, if nobody holds it and the stage is still there."""
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
    """Whether something that no stage is has its name; it may also be just being removed."""
    folder = stage.folder
    if folder.is_symlink() or not folder.is_dir():
        return True
    with suppress(FileNotFoundError):
        return any(folder.iterdir()) and not stage.pid.is_file()
    return True


def _bury(stage: Stage, handle: int) -> None:
    """Complete and remove a dead process' stage, whose lock was taken."""
    try:
        _settle(stage)
        _remove(stage)
    finally:
        os.close(handle)


def _settle(stage: Stage) -> None:
    """Complete what a dead process had begun, and empty the stage."""
    if stage.is_interrupted:
        moves.complete(stage.folder, stage.target)
    for path in stage.contents():
        shutil.rmtree(path)


def _remove(stage: Stage) -> None:
    """Remove a stage that is held, unless it is needed to complete a move; whoever comes next may have to try again."""
    if stage.is_interrupted:
        return
    for path in stage.contents():
        shutil.rmtree(path, ignore_errors=True)
    if not stage.contents():
        with suppress(OSError):
            stage.pid.unlink()
            stage.folder.rmdir()

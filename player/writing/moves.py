"""Moves finished files from a stage into place, and completes moves that a kill interrupted.

A stage holds `new`, and for a while `old` or `old_frames`. At any moment the old or the new version is complete under
its name, or the stage holds everything that is needed to continue:

- A file is renamed over the old file, in one step.
- A folder is swapped with the old folder in one step. If the system cannot swap, the old folder is first moved into the
  stage. If the folder is missing while the stage holds both, the new folder is moved into place.
- The frames of a sequence cannot be swapped in one step. Old frames are moved into the stage, number 0 first, and new
  frames out of it, number 0 last. No reader sees old and new frames together, and a reader that begins at number 0 sees
  all frames or none. The journal `out` names the frames to move away; renamed to `in`, it states that they were moved.
"""

import os
import stat
from contextlib import suppress
from pathlib import Path

from counterlight.writing import disk
from counterlight.writing.numbered import number_of

NEW, OLD, OLD_FRAMES = "new", "old", "old_frames"
CONTENTS = (NEW, OLD, OLD_FRAMES)
_OUT, _IN = "out", "in"
MAX_JOURNAL = 1 << 28  # most bytes of a journal: a million of the longest names
_END = b"\0"  # ends a name in the journal; no name contains it


def put_file(stage: Path, target: Path) -> None:
    made = stage / NEW / target.name
    disk.flush(made)
    disk.move(made, target)


def put_folder(stage: Path, target: Path) -> None:
    """Move `new` into place, swapping it with an existing folder."""
    new, old = stage / NEW, stage / OLD
    disk.flush_tree(new)
    if not os.path.lexists(target):
        disk.move(new, target)
    elif not disk.exchange(new, target):
        try:
            disk.move(target, old)
            disk.move(new, target)
        except BaseException:
            if is_interrupted(stage, target):
                disk.move(old, target)
            raise


def put_sequence(stage: Path, pattern: Path, there: list[str]) -> None:
    """Replace the frames `there`, ordered by number, by the frames in `new`."""
    disk.flush_tree(stage / NEW)
    made = [path.name for path in (stage / NEW).iterdir()]
    (stage / OLD_FRAMES).mkdir()
    journal = stage / OLD_FRAMES / _OUT  # becomes the journal when it is complete
    journal.write_bytes(_END.join(map(os.fsencode, there)))
    disk.flush(journal)
    try:
        disk.move(journal, stage / _OUT)
        _move_frames(stage, pattern)
    except BaseException:
        _take_frames_back(stage, pattern.parent, made)
        raise


def is_interrupted(stage: Path, target: Path) -> bool:
    """Whether a move has begun but is not complete.

    A foreign folder may look like a stage. Therefore links are not followed, and a pipe is no journal.
    """
    if not (_is_folder(stage) and _is_folder(stage / NEW)):
        return False
    return _has_journal(stage) or (_is_folder(stage / OLD) and not os.path.lexists(target))


def complete(stage: Path, target: Path) -> None:
    """Continue an interrupted move. Raises OSError if the system refuses; the move then stays interrupted."""
    if _has_journal(stage):
        _move_frames(stage, target)
    else:
        disk.move(stage / NEW, target)


def _has_journal(stage: Path) -> bool:
    return _is_folder(stage / OLD_FRAMES) and any(_is_journal(stage / name) for name in (_OUT, _IN))


def _is_folder(path: Path) -> bool:
    return os.path.isdir(path) and not os.path.islink(path)  # isdir gives no error for names that are too long


def _is_journal(path: Path) -> bool:
    try:
        status = os.lstat(path)
    except OSError:  # no journal, or another process has just completed the move
        return False
    return stat.S_ISREG(status.st_mode) and status.st_size <= MAX_JOURNAL


def _move_frames(stage: Path, pattern: Path) -> None:
    folder, new, old = pattern.parent, stage / NEW, stage / OLD_FRAMES
    if (stage / _OUT).exists():
        for name in map(os.fsdecode, (stage / _OUT).read_bytes().split(_END)):
            if number_of(pattern.name, name) is not None:  # an empty journal has one empty name
                with suppress(FileNotFoundError):  # the file was already moved
                    os.rename(folder / name, old / name)
        disk.flush(folder)
        disk.flush(old)
        disk.move(stage / _OUT, stage / _IN)
    frames = {number_of(pattern.name, path.name): path for path in new.iterdir()}
    for _, path in sorted(((n, path) for n, path in frames.items() if n is not None), reverse=True):
        os.rename(path, folder / path.name)
    disk.flush(folder)
    (stage / _IN).unlink(missing_ok=True)
    disk.flush(stage)


def _take_frames_back(stage: Path, folder: Path, made: list[str]) -> None:
    """Undo `_move_frames`, last steps first. If the undoing is interrupted, the move can still be completed."""
    if (stage / _IN).exists():
        for name in made:
            if not (stage / NEW / name).exists():
                os.rename(folder / name, stage / NEW / name)
        disk.move(stage / _IN, stage / _OUT)
    if (stage / _OUT).exists():
        for path in (stage / OLD_FRAMES).iterdir():
            os.rename(path, folder / path.name)
        disk.flush(folder)
        (stage / _OUT).unlink()

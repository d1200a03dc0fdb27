"""How what was made in a stage takes its place, and how a move that a kill interrupted is completed.

A stage holds `new`, and for a while `old` or `old_frames`. At any moment either the old or the new is whole at its
name, or what the stage holds says how to go on:

- A file is renamed over the old one: one step.
- A folder changes places with the old one in one step. Where the system cannot do that, the old one is moved into the
  stage first; a folder that is missing while the stage holds both is put there.
- The frames of a sequence cannot change places in one step. Old ones are moved into the stage, number 0 first, new ones
  out of it, number 0 last: nobody sees old and new side by side, and whoever begins at number 0 sees all or nothing.
  The journal `out` names the frames that are to be moved away; renamed `in`, it says that this was done.
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
MAX_JOURNAL = 1 << 28  # bytes: a million of the longest names
_END = b"\0"  # of a name in the journal: no name holds it


def put_file(stage: Path, target: Path) -> None:
    made = stage / NEW / target.name
    disk.flush(made)
    disk.move(made, target)


def put_folder(stage: Path, target: Path) -> None:
    """Let `new` take the place of a folder, or stand where nothing is."""
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
    """Let the frames in `new` take the places of those that are `there`, names in order of their numbers."""
    disk.flush_tree(stage / NEW)
    made = [path.name for path in (stage / NEW).iterdir()]
    (stage / OLD_FRAMES).mkdir()
    journal = stage / OLD_FRAMES / _OUT  # becomes the journal when it is whole
    journal.write_bytes(_END.join(map(os.fsencode, there)))
    disk.flush(journal)
    try:
        disk.move(journal, stage / _OUT)
        _move_frames(stage, pattern)
    except BaseException:
        _take_frames_back(stage, pattern.parent, made)
        raise


def is_interrupted(stage: Path, target: Path) -> bool:
    """Whether a move was begun and not completed.

    A folder from elsewhere may hold what looks like a stage: nothing is moved through links, no pipe is a journal.
    """
    if not (_is_folder(stage) and _is_folder(stage / NEW)):
        return False
    return _has_journal(stage) or (_is_folder(stage / OLD) and not os.path.lexists(target))


def complete(stage: Path, target: Path) -> None:
    """Go on with an interrupted move; OSError where the system refuses, and it stays interrupted."""
    if _has_journal(stage):
        _move_frames(stage, target)
    else:
        disk.move(stage / NEW, target)


def _has_journal(stage: Path) -> bool:
    return _is_folder(stage / OLD_FRAMES) and any(_is_journal(stage / name) for name in (_OUT, _IN))


def _is_folder(path: Path) -> bool:
    return os.path.isdir(path) and not os.path.islink(path)  # no error for names that are too long


def _is_journal(path: Path) -> bool:
    try:
        status = os.lstat(path)
    except OSError:  # none, or somebody has just done what it says
        return False
    return stat.S_ISREG(status.st_mode) and status.st_size <= MAX_JOURNAL


def _move_frames(stage: Path, pattern: Path) -> None:
    folder, new, old = pattern.parent, stage / NEW, stage / OLD_FRAMES
    if (stage / _OUT).exists():
        for name in map(os.fsdecode, (stage / _OUT).read_bytes().split(_END)):
            if number_of(pattern.name, name) is not None:  # an empty journal has one empty name
                with suppress(FileNotFoundError):  # moved already
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
    """Undo what `_move_frames` has done, last things first, so that at any moment it could go on again."""
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

"""Captures on disk, each whole or absent, so that an acquisition can be killed at any moment and resumed.

FOLDER/session.toml            identity of these captures; a run with other options is refused
FOLDER/captures/00012.png      capture 12 (00012_0.png, 00012_1.png … for a bracket), code values from the camera
FOLDER/next.toml  captures_2/  the same for an acquisition that will replace a finished one

A session belongs to one acquisition, which can resume until its room is in place. After that, its captures are used
again only on request. A new acquisition takes new captures and keeps the old ones until its own room is in place.
"""

import shutil
import uuid
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from counterlight.calibration import TOML
from counterlight.errors import InputError, shown
from counterlight.files.manifest import sha256_of, write_toml
from counterlight.files.picture_files import encode_png, read_picture
from counterlight.files.reading import read_toml
from counterlight.files.tables import Table
from counterlight.response import Response
from counterlight.tools.acquisition.averaging import MOST_REPEATS
from counterlight.tools.acquisition.cameras.camera import Exposures, Shot
from counterlight.writing.outputs import check_folder, is_vacant
from counterlight.writing.replacing import filling_folder, holding, replacing_file

SESSION, NEXT = "session.toml", "next.toml"
CAPTURES = ("captures", "captures_2")
FORMAT, UNHALVED, COLOURLESS = 5, 4, 3  # format 4 lacks halves; format 3 also lacks ramps, primaries, coloured check
# keys of a session's description that do not identify its captures
OWN = "id", "captures", "made", "finished", "repeats", "curve", "colours"
FIX = "name another folder with --captures, or remove this one"

Put = Callable[[Path, bytes], None]


@dataclass(frozen=True)
class Wanted:
    """How a run treats captures that already exist.

    room : calibration folder of the acquisition.
    anew : take new captures if those in the folder belong to a finished acquisition.
    reuse : use those captures again.
    """

    room: Path
    anew: bool = False
    reuse: bool = False


class CaptureStore:
    """The captures of one acquisition.

    record : contents of the session file.
    put : writes a file into the captures folder durably.
    writer : thread that compresses and writes a capture while the next picture is shown.
    replaces : whether this acquisition will replace a finished one, whose captures stay until `finish`.
    """

    def __init__(
        self,
        folder: Path,
        record: dict[str, Any],
        exposures: Exposures,
        put: Put,
        writer: Executor,
        *,
        replaces: bool,
    ) -> None:
        self._folder, self._record, self._exposures, self._put = folder, record, exposures, put
        self._captures = folder / str(record["captures"])
        self.replaces = replaces
        self._writer = writer
        self._writing: Future[None] | None = None
        self._size: tuple[int, ...] | None = None

    @property
    def halves(self) -> bool:
        """Whether the captures include a picture and its complement, which older versions lack."""
        return self._record["format"] not in (UNHALVED, COLOURLESS)

    @property
    def coloured(self) -> bool:
        """Whether the captures include ramps, primaries and a coloured check, which older versions lack."""
        return bool(self._record["format"] != COLOURLESS)

    @property
    def averaged(self) -> bool:
        """Whether pictures are captured as often as was chosen at the start of their level."""
        return "repeats" in self._record

    def repeats(self, level: int, choose: Callable[[], int]) -> int:
        """Returns the captures per picture of a level; the choice is on disk before the first capture."""
        chosen: list[int] = self._record["repeats"]
        if level == len(chosen):
            chosen.append(choose())
            self._write()
        return chosen[level]

    def has_curve(self, choose: Callable[[], bool]) -> bool:
        """Returns whether the captures include pictures of the camera's curve, as chosen before the first of them."""
        if "curve" not in self._record:
            self._record["curve"] = choose()
            self._write()
        return bool(self._record["curve"])

    def includes(self, what: str, number: int, choose: Callable[[], bool]) -> bool:
        """Returns whether the captures include some pictures of a projector, as chosen before the first of them.

        what : name of the pictures.
        number : of the projector, from 1.
        """
        chosen: list[bool] = self._record.setdefault(what, [])
        if len(chosen) < number:
            chosen.append(not self._record.get("finished", False) and choose())
            self._write()
        return chosen[number - 1]

    def develop(self, response: Response) -> None:
        """Read the captures with this curve of the camera from now on."""
        self._exposures = replace(self._exposures, response=response)

    @property
    def id(self) -> str:
        """Unique name of the acquisition."""
        return str(self._record["id"])

    def has(self, number: int) -> bool:
        self._settle()
        return all(path.is_file() for path in self._paths(number))

    def save(self, number: int, shots: Sequence[Shot]) -> None:
        """Start writing a capture to disk; the previous capture is safely on disk when this returns.

        Raises InputError if writing fails, if shots and exposures differ in number, and for another size.
        """
        paths = self._paths(number)
        if len(shots) != len(paths):
            raise InputError(f"capture {number}: {len(shots)} shots, expected {len(paths)}, one for each exposure")
        for path, shot in zip(paths, shots, strict=True):
            self._check_size(path, shot)
        self._settle()
        self._writing = self._writer.submit(self._put_shots, paths, shots)

    def _put_shots(self, paths: Sequence[Path], shots: Sequence[Shot]) -> None:
        for path, shot in zip(paths, shots, strict=True):
            self._put(path, encode_png(shot))

    def _settle(self) -> None:
        """Wait until the last capture is safely on disk; InputError if writing fails."""
        writing, self._writing = self._writing, None
        if writing is not None:
            writing.result()

    def shots(self, number: int) -> tuple[Shot, ...]:
        self._settle()
        shots = tuple(read_picture(path) for path in self._paths(number))
        for path, shot in zip(self._paths(number), shots, strict=True):
            self._check_size(path, shot)
        return shots

    def radiance(self, number: int) -> NDArray[np.float32]:
        """Returns the radiance of a capture, (camera height, camera width, 3)."""
        return self._exposures.radiance(self.shots(number))

    def size(self, number: int) -> int:
        """Returns the bytes of a capture on disk."""
        self._settle()
        return sum(path.stat().st_size for path in self._paths(number))

    def made(self, fingerprint: str) -> None:
        """Record that the room with this fingerprint is complete and about to be put in place."""
        self._record["made"] = fingerprint
        self._write()

    def finish(self) -> None:
        """Record that the room is in place, and remove the captures that this acquisition replaces."""
        _finish(self._folder, self._record)

    def _write(self) -> None:
        _write(self._folder / (NEXT if self.replaces else SESSION), self._record)

    def _paths(self, number: int) -> list[Path]:
        count = len(self._exposures.times)
        names = [f"{number:05}"] if count == 1 else [f"{number:05}_{shot}" for shot in range(count)]
        return [self._captures / f"{name}.png" for name in names]

    def _check_size(self, path: Path, shot: Shot) -> None:
        self._size = self._size or shot.shape[:2]
        if shot.shape[:2] != self._size:
            height, width = self._size
            raise InputError(
                f"{path}: {shot.shape[1]}x{shot.shape[0]}, the captures before are {width}x{height}; a camera must "
                "not change its size or orientation in between"
            )


def check_captures(folder: Path, wanted: Wanted) -> None:
    """Raises InputError, before any photograph, if `folder` cannot hold the captures of a run."""
    check_folder(folder)
    kept, coming = _read(folder / SESSION), _read(folder / NEXT)
    if kept is None and not is_vacant(folder):
        raise InputError(f"{folder}: exists and holds no captures of an acquisition; name another with --captures")
    current = coming or kept
    if current is None and wanted.reuse:
        raise InputError(f"{folder}: holds no captures to use again; leave out --reuse-captures")
    if current is not None and _is_finished(current, wanted.room) and not (wanted.anew or wanted.reuse):
        raise InputError(
            f"{folder}: captures of an acquisition that is finished; take new ones with --force, make its room again "
            "with --reuse-captures, or name another folder with --captures"
        )


@contextmanager
def open_store(folder: Path, session: dict[str, Any], exposures: Exposures, wanted: Wanted) -> Iterator[CaptureStore]:
    """Open the captures in `folder`, which is created if missing and locked against other processes.

    session : identity of the captures.

    Raises InputError like `check_captures`, for captures of another session, and for errors of the file system.
    """
    session = {"format": FORMAT, "exposures": list(exposures.times), **session}
    with holding(folder):
        check_captures(folder, wanted)
        folder.mkdir(exist_ok=True)
        kept, coming = _settled(folder, wanted.room)
        current = coming or kept
        if current is None or (_is_finished(current, wanted.room) and not wanted.reuse):
            name = CAPTURES[0] if kept is None or kept["captures"] == CAPTURES[1] else CAPTURES[1]
            current = {**session, "id": uuid.uuid4().hex, "captures": name}
            coming = None if kept is None else current
            _write(folder / (NEXT if coming else SESSION), current)
        else:
            _refuse_other(folder, current, session)
        captures = folder / str(current["captures"])
        captures.mkdir(exist_ok=True)
        with filling_folder(captures) as put, ThreadPoolExecutor(1) as writer:
            yield CaptureStore(folder, current, exposures, put, writer, replaces=coming is not None)


def _settled(folder: Path, room: Path) -> tuple[dict[str, Any] | None, dict[str, Any] | None]:
    """Complete what a killed run began; returns the kept session and the session that will replace it."""
    kept, coming = _read(folder / SESSION), _read(folder / NEXT)
    if kept is not None and coming is not None and (kept["id"] == coming["id"] or _is_finished(coming, room)):
        _finish(folder, coming)
        kept, coming = coming, None
    _remove_captures(folder, besides=[record for record in (kept, coming) if record is not None])
    return kept, coming


def _finish(folder: Path, record: dict[str, Any]) -> None:
    record["finished"] = True
    _write(folder / SESSION, record)
    (folder / NEXT).unlink(missing_ok=True)
    _remove_captures(folder, besides=[record])


def _remove_captures(folder: Path, besides: Sequence[dict[str, Any]]) -> None:
    for name in set(CAPTURES) - {record["captures"] for record in besides}:
        shutil.rmtree(folder / name, ignore_errors=True)


def _is_finished(record: dict[str, Any], room: Path) -> bool:
    """Whether the acquisition's room is, or once was, in place."""
    if record.get("finished") is True:
        return True
    return (room / TOML).is_file() and record.get("made") == sha256_of(room / TOML)


def _refuse_other(folder: Path, stored: dict[str, Any], session: dict[str, Any]) -> None:
    for key in sorted({*stored, *session}.difference({"format", *OWN})):
        if stored.get(key) != session.get(key):
            raise InputError(
                f"{folder}: captures of another acquisition ({key}: {shown(stored.get(key))} there, "
                f"{shown(session.get(key))} here); {FIX}"
            )


def _read(path: Path) -> dict[str, Any] | None:
    """Read a session; None if there is none, InputError if `open_store` did not write it."""
    if not path.exists():
        return None
    stored = read_toml(path, FIX)
    if type(found := stored.get("format")) is not int or found not in (UNHALVED, COLOURLESS):
        Table(stored, str(path), FIX).format(FORMAT)
    if stored.get("captures") not in CAPTURES or not isinstance(stored.get("id"), str):
        raise InputError(f"{path}: does not say which captures are of it; {FIX}")
    repeats = stored.get("repeats", [])
    if not (isinstance(repeats, list) and all(type(count) is int and 1 <= count <= MOST_REPEATS for count in repeats)):
        raise InputError(f"{path}: repeats {shown(repeats)}, expected numbers from 1 to {MOST_REPEATS}; {FIX}")
    return stored


def _write(path: Path, record: dict[str, Any]) -> None:
    with replacing_file(path) as temporary:
        write_toml(temporary, record)


class MemoryStore:
    """The part of CaptureStore that `acquire` needs, without files."""

    halves = coloured = True

    def __init__(self, exposures: Exposures, *, averaged: bool = False) -> None:
        self._exposures, self._kept, self.averaged = exposures, dict[int, Sequence[Shot]](), averaged

    def repeats(self, level: int, choose: Callable[[], int]) -> int:
        return choose()

    def has_curve(self, choose: Callable[[], bool]) -> bool:
        return choose()

    def includes(self, what: str, number: int, choose: Callable[[], bool]) -> bool:
        return choose()

    def develop(self, response: Response) -> None:
        self._exposures = replace(self._exposures, response=response)

    def has(self, number: int) -> bool:
        return number in self._kept

    def save(self, number: int, shots: Sequence[Shot]) -> None:
        self._kept[number] = shots

    def shots(self, number: int) -> Sequence[Shot]:
        return self._kept[number]

    def size(self, number: int) -> int:
        return 0

    def radiance(self, number: int) -> NDArray[np.float32]:
        return self._exposures.radiance(self._kept[number])

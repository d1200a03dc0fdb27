"""Captures on disk, each whole or absent, so that an acquisition can be killed at any moment and go on.

FOLDER/session.toml            what these captures are of; a run with other options is refused
FOLDER/captures/00012.png      capture 12 (00012_0.png, 00012_1.png … for a bracket), codes as the camera gave them
FOLDER/next.toml  captures_2/  the same of an acquisition that will take the place of a finished one

A session is of one acquisition: until its room is in place it goes on where it stopped, and from then on its captures
are of the past. They are used again only by who asks for that; a new acquisition takes its own, and the old ones stay
until its room, too, is in place.
"""

import shutil
import uuid
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from counterlight.calibration import TOML
from counterlight.errors import InputError, shown
from counterlight.files.manifest import sha256_of, write_toml
from counterlight.files.picture_files import read_picture
from counterlight.files.png import encode_png
from counterlight.files.reading import read_toml
from counterlight.files.tables import Table
from counterlight.tools.acquisition.averaging import MOST_REPEATS
from counterlight.tools.acquisition.cameras.camera import Exposures, Shot
from counterlight.writing.outputs import check_folder, is_vacant
from counterlight.writing.replacing import filling_folder, holding, replacing_file

SESSION, NEXT = "session.toml", "next.toml"
CAPTURES = ("captures", "captures_2")
FORMAT, UNHALVED, COLOURLESS = 5, 4, 3  # 4: no halves; 3: no ramps, primaries, coloured check, either; older: refused
OWN = ("id", "captures", "made", "finished", "repeats")  # what a session says beside what it is of
FIX = "name another folder with --captures, or remove this one"

Put = Callable[[Path, bytes], None]


@dataclass(frozen=True)
class Wanted:
    """What a run is to do with captures that are there.

    room : the calibration folder that the acquisition is for.  anew : take new captures, if those are of a finished
    acquisition.  reuse : take them nevertheless.
    """

    room: Path
    anew: bool = False
    reuse: bool = False


class CaptureStore:
    """The captures of one acquisition.

    record : what its session says.  put : puts a file into the folder of the captures, for good.
    writer : a thread that compresses and writes a capture while the next picture is shown.
    replaces : whether it will take the place of a finished acquisition, whose captures stay until `finish`.
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
        """Whether a picture and its complement are among them: not in those of an older version."""
        return self._record["format"] not in (UNHALVED, COLOURLESS)

    @property
    def coloured(self) -> bool:
        """Whether ramps, primaries and a coloured check are among them: not in those of an older version."""
        return bool(self._record["format"] != COLOURLESS)

    @property
    def averaged(self) -> bool:
        """Whether each level's pictures are captured as often as was chosen when it began."""
        return "repeats" in self._record

    def repeats(self, level: int, choose: Callable[[], int]) -> int:
        """Captures of each picture of a level; what was chosen is on disk before the first of them."""
        chosen: list[int] = self._record["repeats"]
        if level == len(chosen):
            chosen.append(choose())
            self._write()
        return chosen[level]

    @property
    def id(self) -> str:
        """What no other acquisition has."""
        return str(self._record["id"])

    def has(self, number: int) -> bool:
        self._settle()
        return all(path.is_file() for path in self._paths(number))

    def save(self, number: int, shots: Sequence[Shot]) -> None:
        """Begin to put a capture on disk. The one before is there for good when this returns.

        Raises InputError where the disk refuses, for another count of shots than exposures, and for another size.
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
        """What was saved is on disk for good when this returns; InputError where the disk refuses."""
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
        """(camera height, camera width, 3)."""
        return self._exposures.radiance(self.shots(number))

    def size(self, number: int) -> int:
        """Bytes of a capture."""
        self._settle()
        return sum(path.stat().st_size for path in self._paths(number))

    def made(self, fingerprint: str) -> None:
        """The room with that fingerprint is whole, and about to be put in place."""
        self._record["made"] = fingerprint
        self._write()

    def finish(self) -> None:
        """The room is in place: these captures are of the past, and those that they replace are removed."""
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
    """InputError, before anything is photographed, if `folder` cannot hold the captures of a run."""
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
    """The captures in `folder`, which is made if it is not there; no other process writes there meanwhile.

    session : what they are of.
    Raises InputError as `check_captures` does, for captures of something else, and where the system refuses.
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
    """The session that is kept and the one that will take its place, after what a killed run had begun is completed."""
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
    """Whether the acquisition's room is in place, or was."""
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
    """A session; None where there is none. InputError for what no `open_store` wrote."""
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

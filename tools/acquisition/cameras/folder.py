"""A camera that another program controls: patterns are written to a folder and captures are read, level by level.

FOLDER/patterns/00012.png    picture to show: 8-bit, the projector's size; RGB unless it is black and white
FOLDER/captures/00012.png    its capture (or .jpg, .dng …); with a bracket 00012_0.png, 00012_1.png …
FOLDER/acquisition.toml      the acquisition or check that owns the files, so that captures are never mixed up

To aim such a camera, FOLDER/aim holds the picture to show and the newest photograph.
"""

import math
import re
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from counterlight.errors import InputError
from counterlight.files.manifest import write_toml
from counterlight.files.picture_files import encode_png
from counterlight.files.reading import read_toml
from counterlight.files.tables import Table
from counterlight.tools.acquisition.cameras.camera import Exposures, Shot
from counterlight.tools.acquisition.plan import Codes, Picture
from counterlight.tools.hdr.photographs import SUFFIXES, read_photograph, refuse_curve
from counterlight.tools.hdr.raw_files import is_raw, read_exposure
from counterlight.writing.replacing import filling_folder, replacing_file

ACQUISITION = "acquisition.toml"
POLL_S = 0.2
LISTED = 3  # names in a message
CHECK, CHECKED = "check ", "checked"  # a check's id begins with CHECK; CHECKED is the id once the check has ended
MOST = 1 << 40
THIRD_STOP = 0.4  # tolerance in stops: files hold nominal times, up to a third of a stop off
ANY_CASE = frozenset((*SUFFIXES, *(suffix.upper() for suffix in SUFFIXES)))
_NUMBERED = re.compile(r"(?P<number>\d{5,})(_(?P<shot>\d+))?")
PATTERN = "pattern.png"
NOTHING = 480, 640  # size of the placeholder until there is a photograph


class Waiting(InputError):  # noqa: N818 - no fault: a run that goes on later
    """Captures are missing.

    first : number of the first missing capture.
    waited : whether the run waited for captures and none came.
    """

    def __init__(self, message: str, first: int, *, waited: bool) -> None:
        super().__init__(message)
        self.first, self.waited = first, waited


class FolderCamera:
    """The camera back end of a folder.

    wait_s : seconds to wait for the captures of a level before giving up; the next run resumes there.
    """

    def __init__(self, folder: Path, exposures: Exposures, wait_s: float = 0.0) -> None:
        self._folder, self._exposures, self._wait_s = folder, exposures, wait_s
        self._exposed = 0.0  # exposure of the first RAW file that states it, per unit of --exposures
        self._goes_on = False  # a check is resumed, and its later levels may already have captures

    @property
    def name(self) -> str:
        return "folder"

    @property
    def exposures(self) -> Exposures:
        return self._exposures

    @property
    def waits(self) -> bool:
        """Whether the camera waits for captures; otherwise their duration is unknown."""
        return self._wait_s > 0

    def bind(self, acquisition: str, *, first: bool) -> None:
        """Reserve the folder for an acquisition, by its id; InputError if it holds another acquisition's captures.

        first : whether the folder had no earlier acquisition. Captures without a known owner then belong to this one.
        """
        path, seen = self._folder / ACQUISITION, self._folder / "captures"
        bound = read_toml(path, f"remove {path}").get("id") if path.exists() else None
        if bound == acquisition:
            return
        if (bound is not None or not first) and seen.is_dir() and any(_pictures(seen)):
            raise InputError(f"{seen}: holds captures of another acquisition; move them away, or name another folder")
        shown, _ = self._make_folders()
        for pattern in shown.glob("*.png"):  # patterns of the previous acquisition with the same numbers
            pattern.unlink()
        self._record(acquisition)

    def begin(self, check: str) -> int:
        """Reserve the folder for a check of a room, by its id; returns the number of its first capture.

        Without --wait, an unfinished check of the same id is resumed. Otherwise the check restarts, and its old
        files are removed. Raises InputError if the folder holds an acquisition's captures.
        """
        path, seen = self._folder / ACQUISITION, self._folder / "captures"
        record = read_toml(path, f"remove {path}") if path.exists() else {}
        bound, first = (
            str(record.get("id", "")),
            Table(record, f"{path}", f"remove {path}").integer("first", 0, 0, MOST),
        )
        self._goes_on = bound == CHECK + check and not self.waits
        if self._goes_on:
            return first
        if bound.startswith(CHECK):
            first = self._clear(first)
        elif bound != CHECKED and seen.is_dir() and any(_pictures(seen)):
            raise InputError(f"{seen}: holds captures of an acquisition; move them away, or name another folder")
        self._make_folders()
        self._record(CHECK + check, first=first)
        return first

    def end(self, first: int) -> None:
        """End the check that began with capture `first`, and remove its pictures and captures."""
        self._record(CHECKED, first=self._clear(first))

    def _record(self, bound: str, **more: int) -> None:
        with replacing_file(self._folder / ACQUISITION) as temporary:
            write_toml(temporary, {"id": bound, **more})

    def _clear(self, first: int) -> int:
        """Remove files numbered from `first` on; returns a number that was never used."""
        following = first
        for folder in self._make_folders():
            for path in list(_pictures(folder)):
                named = _NUMBERED.fullmatch(path.stem)
                if named is not None and int(named["number"]) >= first:
                    following = max(following, int(named["number"]) + 1)
                    path.unlink(missing_ok=True)
        return following

    def prepare(self, first: int, patterns: Sequence[Picture], missing: Sequence[int]) -> None:
        """Write the patterns; raises Waiting for missing captures and InputError for captures without a pattern."""
        shown, seen = self._make_folders()
        with filling_folder(shown) as put:
            for number in missing:
                path = shown / f"{number:05}.png"
                if not path.exists():
                    put(path, encode_png(_stored(patterns[number - first])))
        there = self._goes_on and not self._absent(missing)
        # without this condition, captures of later levels from an earlier run would be refused
        if missing and not there:
            self._refuse_strangers(shown, seen, first + len(patterns))
        deadline = time.monotonic() + self._wait_s
        while absent := self._absent(missing):
            if time.monotonic() >= deadline:
                raise Waiting(_waiting(seen, absent), int(absent[0].partition("_")[0]), waited=self.waits)
            time.sleep(POLL_S)

    def capture(self, number: int, picture: Picture) -> tuple[Shot, ...]:
        found = [self._find(stem) or self._folder / "captures" / f"{stem}.png" for stem in self._stems(number)]
        for path, time_s in zip(found, self._exposures.times, strict=True):
            if is_raw(path):
                refuse_curve(path, self._exposures.response, "--camera-response")
                self._check_exposure(path, time_s)
        return tuple(read_photograph(path) for path in found)

    def _check_exposure(self, path: Path, time_s: float) -> None:
        """Raises InputError if a RAW file's exposure, relative to --exposures, differs from the first file's."""
        tags = read_exposure(path)
        if tags.time_s is None:
            return
        exposed = tags.time_s * (tags.iso or 1) / (tags.aperture or 1) ** 2 / time_s
        self._exposed = self._exposed or exposed
        if abs(math.log2(exposed / self._exposed)) > THIRD_STOP:
            raise InputError(
                f"{path}: exposed {exposed / self._exposed:.2g} times as much as --exposures says, by the first "
                "capture; set time, ISO and aperture by hand, give --exposures in the order of the shots"
            )

    def _make_folders(self) -> tuple[Path, Path]:
        """Create and return the folders of patterns and of captures."""
        folders = self._folder / "patterns", self._folder / "captures"
        for folder in folders:
            try:
                folder.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise InputError(f"{folder}: cannot be made ({error.strerror}); check path and rights") from None
        return folders

    def _stems(self, number: int) -> list[str]:
        count = len(self._exposures.times)
        return [f"{number:05}"] if count == 1 else [f"{number:05}_{shot}" for shot in range(count)]

    def _absent(self, numbers: Sequence[int]) -> list[str]:
        there = {path.stem for path in _pictures(self._folder / "captures")}
        return [stem for number in numbers for stem in self._stems(number) if stem not in there]

    def _find(self, stem: str) -> Path | None:
        paths = (self._folder / "captures" / f"{stem}{suffix}" for suffix in ANY_CASE)
        return next((path for path in paths if path.is_file()), None)

    def _refuse_strangers(self, shown: Path, folder: Path, end: int) -> None:
        """Raises InputError for captures of pictures that were never shown; an earlier run may have shown more."""
        found: dict[str, Path] = {}
        for path in _pictures(folder):
            if path.stem in found:
                raise InputError(f"{path}: the same capture as {found[path.stem].name}; keep one of the two")
            found[path.stem] = path
            named = _NUMBERED.fullmatch(path.stem)
            number = int(named["number"]) if named else -1
            known = 0 <= number < end or (shown / f"{number:05}.png").exists()
            if not known or path.stem not in self._stems(number):
                raise InputError(
                    f"{path}: belongs to no pattern, expected {self._stems(0)[0]}.png to "
                    f"{self._stems(end - 1)[-1]}.png so far; move it out of the folder, or check --exposures"
                )


def _stored(picture: Picture) -> NDArray[np.uint8]:
    """Returns (height, width) grey for a black-and-white picture, otherwise (height, width, 3)."""
    return picture.astype(np.uint8) * np.uint8(255) if picture.dtype == np.bool_ else picture.astype(np.uint8)


def _pictures(folder: Path) -> Iterator[Path]:
    yield from (p for p in sorted(folder.iterdir()) if p.suffix in ANY_CASE and not p.name.startswith("."))


def _waiting(folder: Path, absent: Sequence[str]) -> str:
    names = ", ".join(f"{stem}.png" for stem in absent[:LISTED])
    names += f" … {absent[-1]}.png" if len(absent) > LISTED else ""
    return (
        f"{folder}: waiting for {len(absent)} captures, {names}; show the patterns of the same numbers, put their "
        "captures (PNG, JPEG or RAW) there and run the same command again (or give --wait SECONDS)"
    )


class AimedFolder:
    """A screen that writes FOLDER/aim/pattern.png, and a camera that reads the newest photograph in FOLDER/aim."""

    timed, refresh_hz = False, None

    def __init__(self, folder: Path, shape: tuple[int, int]) -> None:
        self._folder, self.shape = folder / "aim", shape
        self._read: tuple[Path, int] | None = None
        self._shot: Shot = np.zeros(NOTHING, np.uint8)
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{self._folder}: cannot be made ({error.strerror}); check path and rights") from None

    @property
    def name(self) -> str:
        return f"{self._read[0].name}" if self._read else f"waiting for a photograph in {self._folder}"

    def show(self, codes: Codes) -> None:
        with replacing_file(self._folder / PATTERN) as temporary:
            temporary.write_bytes(encode_png(codes))

    def begin(self, number: int) -> None:
        """Does nothing: frames do not depend on a capture's number."""

    def expose(self, time: float) -> None:
        raise InputError("folder: the exposure is set at the camera")

    def skip(self) -> None:
        """Does nothing: a folder has no frames to skip."""

    def last(self) -> Shot:
        return self.frame()

    def frame(self) -> Shot:
        """Returns the newest photograph, or the previous photograph while the newest is incomplete."""
        newest = max(self._photographs(), default=None)
        if newest is not None:
            changed, path = newest
            if self._read != (path, changed):
                with suppress(InputError):  # the newest photograph may still be incomplete
                    self._shot, self._read = read_photograph(path), (path, changed)
        return self._shot

    def _photographs(self) -> list[tuple[int, Path]]:
        paths = [p for p in self._folder.iterdir() if p.suffix.lower() in SUFFIXES and p.name != PATTERN]
        return [(path.stat().st_mtime_ns, path) for path in paths if not path.name.startswith(".")]

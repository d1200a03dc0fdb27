"""The media that are played in turn: media of the command line, lists in .m3u and .txt files, and folders."""

import os
import re
from collections.abc import Sequence
from pathlib import Path

from counterlight.errors import InputError
from counterlight.media.medium import Border, Medium, live_address
from counterlight.writing.numbered import natural, number_of

LISTS = (".m3u", ".m3u8", ".txt")
# suffixes of the films and pictures that a folder stands for
PLAYED = re.compile(
    r"\.(avi|flv|m2ts|m4v|mkv|mov|mp4|mpe?g|mts|mxf|ogv|ts|webm|wmv|"
    r"avif|bmp|dpx|exr|gif|hei[cf]|jp2|jpe?g|jxl|png|ppm|tga|tiff?|webp)"
)
MAX_LIST_BYTES = 4 << 20
MAX_MEDIA = 10_000


class Playlist:
    """Media in order, and the current position. Positions count from 0."""

    def __init__(self, media: Sequence[Medium | str], *, loop: bool = False, start: int = 0) -> None:
        self.media, self.loop, self.position = [Medium.of(each) for each in media], loop, min(start, len(media) - 1)

    @property
    def current(self) -> Medium:
        return self.media[self.position]

    def after(self, by: int = 1) -> int | None:
        """Return the position `by` places further, None if there is none. A looped list wraps around."""
        target = self.position + by
        if self.loop:
            target %= len(self.media)
        return target if 0 <= target < len(self.media) else None

    def step(self, by: int) -> bool:
        """Go `by` places further. Returns False, and stays, if there is no such place."""
        target = self.after(by)
        if target is not None:
            self.position = target
        return target is not None

    def add(self, media: Sequence[Medium], *, replace: bool, at: int | None = None) -> None:
        """Insert media or replace the whole list. Raises InputError if the list becomes too long.

        media : the new media.
        replace : whether to replace the whole list.
        at : position to insert at; None for the end.
        """
        at = len(self.media) if at is None else at
        whole = list(media) if replace else [*self.media[:at], *media, *self.media[at:]]
        if len(whole) > MAX_MEDIA:
            raise InputError(f"{len(whole)} media, a list holds {MAX_MEDIA}; replace the list")
        self.media = whole
        self.position = 0 if replace else self.position

    def unfold(self, media: Sequence[Medium]) -> None:
        """Replace the current entry, which is a list, by the media that it lists."""
        whole = [*self.media[: self.position], *media, *self.media[self.position + 1 :]]
        if len(whole) > MAX_MEDIA:
            raise InputError(f"{self.current}: {len(whole)} media, a list holds {MAX_MEDIA}; split the list")
        self.media = whole


def expand(media: Sequence[Medium], border: Border, *, patient: bool = False) -> list[Medium]:
    """Replace every list and every folder by its media, as far as the border allows.

    Raises InputError if a list cannot be read or too many media are left.

    patient : keep an unreadable list as an entry, so that the show tries it again.
    """
    found: list[Medium] = []
    for medium in media:
        try:
            found += listed(medium, border)
        except InputError:
            if not patient:
                raise
            found.append(medium)
    if len(found) > MAX_MEDIA:
        raise InputError(f"{len(found)} media, at most {MAX_MEDIA} are played; name fewer")
    return found


def files_of(medium: Medium) -> list[Path]:
    """Return a medium's file, or the files that a numbered pattern matches; none if live or out of bounds."""
    path = Path(medium.name)
    try:
        medium.check()
        medium.inside(path.parent)
    except InputError:
        return []
    if medium.live() is not None:
        return []
    if medium.is_sequence and path.parent.is_dir():
        return [entry for entry in path.parent.iterdir() if number_of(path.name, entry.name) is not None]
    return [path]


def is_list(medium: Medium) -> bool:
    """Whether a name means a list or a folder. Looks at the disk only for names without a suffix."""
    path = Path(medium.name)
    named = path.suffix.lower() in LISTS or (not path.suffix and os.path.isdir(path))
    return named and live_address(medium.name) is None


def listed(medium: Medium, border: Border) -> list[Medium]:
    """Return the media of a list or a folder, otherwise the medium itself. May take long."""
    if medium.live() is None and os.path.isdir(medium.name):
        return _in_folder(medium, border)
    return read_list(medium, border) if is_list(medium) else [medium]


def entries_of(medium: Medium) -> list[Path]:
    """Return what a folder holds, sorted as people count. Names that begin with a dot are omitted."""
    medium.check()
    folder = Path(medium.name)
    try:
        names = [name for name in os.listdir(medium.inside(folder)) if not name.startswith(".")]
    except OSError as error:
        raise InputError(f"{folder}: {error.strerror}; check its name and its rights") from None
    return [folder / name for name in sorted(names, key=natural)]


def _in_folder(medium: Medium, border: Border) -> list[Medium]:
    """Return the films and pictures of a folder. For a folder of the command line, they may be below the folder."""
    found = [path for path in entries_of(medium) if PLAYED.fullmatch(path.suffix.lower())]
    if not found:
        raise InputError(f"{medium}: a folder without films and pictures; name a folder with some, or a file")
    inner = border.within(Path(medium.name)) if medium.roots is None else border
    return [inner.medium(str(path)) for path in found]


def read_list(medium: Medium, border: Border) -> list[Medium]:
    """Return the media of a list file: one path or address per line, relative to the list's folder; # begins a comment.

    Entries must be within the border. For a list of the command line, they may also be below the list's folder. Raises
    InputError for a list in a list.
    """
    path = Path(medium.name)
    inner = border.within(path.parent) if medium.roots is None else border
    lines = [line for line in map(str.strip, _text(medium, path).splitlines()) if line and not line.startswith("#")]
    for line in lines:
        if is_list(Medium(line)):
            raise InputError(f"{path}: lists the list {line}; name media only")
    if not lines:
        raise InputError(f"{path}: lists no medium; put one path in each line")
    return [inner.medium(_located(path.parent, line)) for line in lines]


def _text(medium: Medium, path: Path) -> str:
    medium.check()
    try:
        with medium.file(path, may_be_empty=True).open("rb") as file:
            contents = file.read(MAX_LIST_BYTES + 1)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}; check the list and its rights") from None
    if len(contents) > MAX_LIST_BYTES:
        raise InputError(f"{path}: more than {MAX_LIST_BYTES} bytes; split the list")
    try:
        return contents.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{path}: no UTF-8 text; save the list as UTF-8") from None


def _located(folder: Path, line: str) -> str:
    return line if live_address(line) or "://" in line else str(folder / line)

"""What is played one after the other: media of the command line, and lists of media in .m3u and .txt files."""

from collections.abc import Sequence
from pathlib import Path

from counterlight.errors import InputError
from counterlight.media.decoding.live import live_address
from counterlight.media.medium import Border, Medium
from counterlight.writing.numbered import number_of

LISTS = (".m3u", ".m3u8", ".txt")
MAX_LIST_BYTES = 4 << 20
MAX_MEDIA = 10_000


class Playlist:
    """Media in order, and which one is on. Positions count from 0."""

    def __init__(self, media: Sequence[Medium | str], *, loop: bool = False, start: int = 0) -> None:
        self.media, self.loop, self.position = [Medium.of(each) for each in media], loop, min(start, len(media) - 1)

    @property
    def current(self) -> Medium:
        return self.media[self.position]

    def after(self, by: int = 1) -> int | None:
        """The position that is so many further, round about if the list is looped; None if there is nothing there."""
        target = self.position + by
        if self.loop:
            target %= len(self.media)
        return target if 0 <= target < len(self.media) else None

    def step(self, by: int) -> bool:
        """Go on (1) or back (-1); False, staying, if there is nothing there."""
        target = self.after(by)
        if target is not None:
            self.position = target
        return target is not None

    def add(self, media: Sequence[Medium], *, replace: bool, at: int | None = None) -> None:
        """Insert media before a position, None for the end, or replace everything; InputError if that is too many."""
        at = len(self.media) if at is None else at
        whole = list(media) if replace else [*self.media[:at], *media, *self.media[at:]]
        if len(whole) > MAX_MEDIA:
            raise InputError(f"{len(whole)} media, a list holds {MAX_MEDIA}; replace the list")
        self.media = whole
        self.position = 0 if replace else self.position

    def unfold(self, media: Sequence[Medium]) -> None:
        """Put what the current entry, a list, lists in its place."""
        whole = [*self.media[: self.position], *media, *self.media[self.position + 1 :]]
        if len(whole) > MAX_MEDIA:
            raise InputError(f"{self.current}: {len(whole)} media, a list holds {MAX_MEDIA}; split the list")
        self.media = whole


def expand(media: Sequence[Medium], border: Border, *, patient: bool = False) -> list[Medium]:
    """Media with every list replaced by what it lists, as far as the border lets it.

    patient : keep a list that cannot be read as it is, for the show to try again.
    Raises InputError if nothing is left or a list cannot be read.
    """
    found: list[Medium] = []
    for medium in media:
        try:
            found += read_list(medium, border) if is_list(medium) else [medium]
        except InputError:
            if not patient:
                raise
            found.append(medium)
    if len(found) > MAX_MEDIA:
        raise InputError(f"{len(found)} media, at most {MAX_MEDIA} are played; name fewer")
    return found


def files_of(medium: Medium) -> list[Path]:
    """The files that a medium is: itself, those that a numbered pattern matches; none if it is live or out of reach."""
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
    return Path(medium.name).suffix.lower() in LISTS and live_address(medium.name) is None


def read_list(medium: Medium, border: Border) -> list[Medium]:
    """The media of a list: a path or address a line, relative to the list's folder; # begins a comment.

    They reach what is below that folder and what the border lets everybody reach, or as far as a list that is beyond
    the border itself. A list's entries are media: a list in a list is refused.
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

"""What is played one after the other: media of the command line, and lists of media in .m3u and .txt files."""

from collections.abc import Sequence
from pathlib import Path

from player.decoding.live import live_address
from player.errors import InputError
from player.writing.numbered import is_numbered, number_of

LISTS = (".m3u", ".m3u8", ".txt")
MAX_LIST_BYTES = 4 << 20


class Playlist:
    """Media in order, and which one is on. Positions count from 0."""

    def __init__(self, media: Sequence[str], *, loop: bool = False, start: int = 0) -> None:
        self.media, self.loop, self.position = list(media), loop, min(start, len(media) - 1)

    @property
    def current(self) -> str:
        return self.media[self.position]

    def step(self, by: int) -> bool:
        """Go on (1) or back (-1), round about if the list is looped; False, staying, if there is nothing there."""
        target = self.position + by
        if self.loop:
            target %= len(self.media)
        if not 0 <= target < len(self.media):
            return False
        self.position = target
        return True

    def add(self, media: Sequence[str], *, replace: bool) -> None:
        """Put media at the end, or in place of everything."""
        if replace:
            self.media, self.position = list(media), 0
        else:
            self.media += media


def expand(media: Sequence[str]) -> list[str]:
    """Media with every list replaced by what it lists; InputError if nothing is left or a list cannot be read."""
    found = [entry for name in media for entry in (read_list(Path(name)) if is_list(name) else [name])]
    if media and not found:
        raise InputError(f"{', '.join(media)}: lists no medium; put one path in each line")
    return found


def files_of(medium: str) -> list[Path]:
    """The files that a medium is: itself, those that a numbered pattern matches, or none of a live source."""
    if live_address(medium) is not None:
        return []
    path = Path(medium)
    if is_numbered(path) and not path.exists() and path.parent.is_dir():
        return [entry for entry in path.parent.iterdir() if number_of(path.name, entry.name) is not None]
    return [path]


def is_list(name: str) -> bool:
    return Path(name).suffix.lower() in LISTS and live_address(name) is None


def read_list(path: Path) -> list[str]:
    """The media of a list: a path or address a line, relative to the list's folder; # begins a comment.

    A list's entries are media: a list in a list is refused.
    """
    try:
        if path.stat().st_size > MAX_LIST_BYTES:
            raise InputError(f"{path}: {path.stat().st_size} bytes, at most {MAX_LIST_BYTES} are read; split the list")
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{path}: no UTF-8 text; save the list as UTF-8") from None
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; check its name") from None
    lines = [line.strip() for line in text.splitlines()]
    media = [line for line in lines if line and not line.startswith("#")]
    for entry in media:
        if is_list(entry):
            raise InputError(f"{path}: lists the list {entry}; name media only")
    return [entry if live_address(entry) or "://" in entry else str(path.parent / entry) for entry in media]

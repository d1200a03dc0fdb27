"""Media by name, and how far a name reaches: the command line's anywhere, that of a list or of a remote up to a border.

`Border` decides, once, when a name comes in; the decoder's process holds the medium to it whenever it opens something.
docs/security.md says who is trusted with what.
"""

import os
import re
import stat
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Self

from counterlight.errors import InputError
from counterlight.media.decoding.live import LiveAddress, is_device, live_address
from counterlight.writing.numbered import is_numbered

MAX_NAME = 4096  # bytes: the longest path that Linux opens
INSIDE = "a list or a remote may name files below its folder or a --media-root only"


@dataclass(frozen=True)
class Medium:
    """A file, a numbered sequence or a live source.

    roots : folders below which its files must be, links followed, and then it is nothing but files; None for a name
        that may be anything.
    """

    name: str
    roots: tuple[str, ...] | None = None

    def __str__(self) -> str:
        return self.name

    @classmethod
    def of(cls, name: "Medium | Path | str") -> "Medium":
        """The medium of a name that the caller vouches for."""
        return name if isinstance(name, Medium) else cls(str(name))

    def live(self) -> LiveAddress | None:
        """How to open it if it is live; None for files."""
        return live_address(self.name) if self.roots is None else None

    def check(self) -> None:
        """Raise InputError for a name that may not be said here, or that nothing can have; looks at no file."""
        try:
            size = len(os.fsencode(self.name))
        except UnicodeEncodeError:
            size = 0
        if not 0 < size <= MAX_NAME or "\0" in self.name:
            raise InputError(f"{self.name[:80]!r}: no file has such a name; check it")
        if web := re.match(r"(https?|ftp|file)://", self.name):
            told = "give its path" if web[1] == "file" else "download it, and play the file"
            raise InputError(f"{self.name}: {web[1]} addresses are not played; {told}")
        if self.roots is not None and live_address(self.name):
            raise InputError(f"{self.name}: {_who_may(self.name)}")

    @property
    def is_sequence(self) -> bool:
        """Whether it is numbered pictures: a pattern of their names, and no file of that very name."""
        path = Path(self.name)
        return self.live() is None and is_numbered(path) and not os.path.lexists(path)

    def look(self) -> None:
        """Raise InputError if it is plain that it cannot be opened: not allowed, not there, no file. May take long."""
        self.check()
        if self.is_sequence:
            self.inside(Path(self.name).parent)
        elif self.live() is None:
            self.file(Path(self.name))

    def file(self, path: Path, *, may_be_empty: bool = False) -> Path:
        """A file of this medium without links; InputError if it is none, or not one that the medium may reach."""
        try:
            real = self.inside(path)
            status = real.stat()
        except FileNotFoundError:
            raise InputError(f"{path}: no such file; check its name") from None
        except OSError as error:
            raise InputError(f"{path}: {error.strerror}; check its name and its rights") from None
        if stat.S_ISDIR(status.st_mode):
            raise InputError(f"{path}: is a folder; name a file, or a sequence such as {path / '%05d.png'}")
        if not stat.S_ISREG(status.st_mode):
            raise InputError(f"{path}: not a regular file; copy the medium to one")
        if status.st_size == 0 and not may_be_empty:
            raise InputError(f"{path}: empty (0 bytes); copy or export it again")
        if not os.access(real, os.R_OK):
            raise InputError(f"{path}: this user may not read it; change its rights")
        return real

    def inside(self, path: Path) -> Path:
        """A path without links, which is where it has to be; InputError if it is not."""
        real = os.path.realpath(path)
        if self.roots is not None and not any(_is_below(real, root) for root in self.roots):
            raise InputError(f"{path}: {INSIDE}")
        return Path(real)


@dataclass(frozen=True)
class Border:
    """What lists and remotes may name: files below `roots`; streams that the command line `named`, or all if `live`."""

    roots: tuple[str, ...] = ()
    live: bool = False
    named: frozenset[str] = field(default_factory=frozenset)

    @classmethod
    def around(cls, media: Iterable[Medium], roots: Iterable[Path], *, live: bool) -> Self:
        """The border that a command line draws: given roots, and the folders of the files that it names."""
        files = [Path(medium.name) for medium in media if medium.live() is None]
        folders = dict.fromkeys(os.path.abspath(folder) for folder in [*roots, *(file.parent for file in files)])
        return cls(tuple(folders), live, frozenset(medium.name for medium in media if medium.live()))

    def within(self, folder: Path) -> "Border":
        """The same, and what is below another folder."""
        return replace(self, roots=(*self.roots, os.path.abspath(folder)))

    def medium(self, name: str) -> Medium:
        """The medium that somebody beyond the border names; Medium.check says whether he may."""
        stream = live_address(name) is not None and not is_device(name)
        return Medium(name) if stream and (self.live or name in self.named) else Medium(name, self.roots)


def _is_below(real: str, root: str) -> bool:
    folder = os.path.realpath(root)
    return os.path.commonpath([real, folder]) == folder


def _who_may(name: str) -> str:
    if is_device(name):
        return "only the command line may name devices and filters"
    return "not named on the command line; add --allow-live to let lists and remotes name streams"

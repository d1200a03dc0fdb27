"""Names of media and access rights: films, pictures, numbered pictures, and live cameras and streams.

`Border` decides once, when a name is read. The decoder process checks the medium again whenever it opens a file.
docs/security.md describes who is trusted with what.
"""

import os
import re
import stat
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Self

from counterlight.errors import InputError
from counterlight.writing.numbered import is_numbered

STEADY_S = 10.0  # after a connection of this length, the next attempt is immediate again
_DEVICES = re.compile(r"(v4l2|lavfi|dshow|avfoundation|x11grab):(.+)", re.DOTALL)
_STREAMS = re.compile(r"(rtsp|rtsps|rtmp|rtp|udp|srt|tcp)://.+")
# Protocols of each kind of stream. FFmpeg opens no other protocol for it, whatever the sender requests.
_PROTOCOLS = {
    "rtsp": "rtp,srtp,udp,tcp",
    "rtsps": "rtp,srtp,udp,tcp,tls",
    "rtmp": "rtmp,tcp",
    "rtp": "rtp,udp",
    "udp": "udp",
    "srt": "srt",
    "tcp": "tcp",
}
_DEVICE_PROTOCOLS = "file"  # the protocol of a device; it needs none, but FFmpeg takes an empty list for all protocols


@dataclass(frozen=True)
class LiveAddress:
    """What FFmpeg opens.

    address : passed to FFmpeg.
    format : FFmpeg's input format; None to detect it.
    protocols : protocols that FFmpeg may use.
    """

    address: str
    format: str | None
    protocols: str


def live_address(name: str) -> LiveAddress | None:
    """Parse `v4l2:/dev/video0`, `/dev/video0`, `lavfi:testsrc`, `rtsp://…`, `udp://…`. Returns None for files."""
    if match := _DEVICES.fullmatch(name):
        return LiveAddress(match[2], match[1], _DEVICE_PROTOCOLS)
    if match := _STREAMS.fullmatch(name):
        return LiveAddress(name, None, _PROTOCOLS[match[1]])
    if name.startswith("/dev/video") and _is_character_device(Path(name)):
        return LiveAddress(name, "v4l2", _DEVICE_PROTOCOLS)
    return None


def is_device(name: str) -> bool:
    """Whether a name means a camera, a screen or a filter graph of this computer."""
    return _DEVICES.fullmatch(name) is not None or name.startswith("/dev/")


def _is_character_device(path: Path) -> bool:
    try:
        return stat.S_ISCHR(path.stat().st_mode)
    except (OSError, ValueError):
        return False


MAX_NAME = 4096  # bytes: the longest path that Linux opens
INSIDE = "a list or a remote may name files below its folder or a --media-root only"


@dataclass(frozen=True)
class Medium:
    """A file, a numbered sequence or a live source.

    roots : folders that must contain its files, with links resolved; it may then not be live. None allows any name.
    """

    name: str
    roots: tuple[str, ...] | None = None

    def __str__(self) -> str:
        return self.name

    @classmethod
    def of(cls, name: "Medium | Path | str") -> "Medium":
        """Return the medium of a name that the caller trusts."""
        return name if isinstance(name, Medium) else cls(str(name))

    def live(self) -> LiveAddress | None:
        """Return how to open a live source, None for files."""
        return live_address(self.name) if self.roots is None else None

    def check(self) -> None:
        """Raise InputError for a forbidden or impossible name. Accesses no file."""
        try:
            size = len(os.fsencode(self.name))
        except UnicodeEncodeError:
            size = 0
        if not 0 < size <= MAX_NAME or "\0" in self.name:
            raise InputError(f"{self.name[:80]!r}: no file has such a name; check it")
        if web := re.match(r"(https?|ftp|file)://", self.name):
            remedy = "give its path" if web[1] == "file" else "download it, and play the file"
            raise InputError(f"{self.name}: {web[1]} addresses are not played; {remedy}")
        if self.roots is not None and live_address(self.name):
            raise InputError(f"{self.name}: {_who_may(self.name)}")

    @property
    def is_sequence(self) -> bool:
        """Whether the name is a pattern for numbered pictures, and no file has exactly this name."""
        path = Path(self.name)
        return self.live() is None and is_numbered(path) and not os.path.lexists(path)

    def look(self) -> None:
        """Raise InputError for an obvious obstacle: forbidden, missing, or no file. May take long."""
        self.check()
        if self.is_sequence:
            self.inside(Path(self.name).parent)
        elif self.live() is None:
            self.file(Path(self.name))

    def file(self, path: Path, *, may_be_empty: bool = False) -> Path:
        """Return a file with links resolved. Raises InputError if it is no readable file within `roots`."""
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
        """Return a path with links resolved. Raises InputError if it is not within `roots`."""
        real = os.path.realpath(path)
        if self.roots is not None and not any(_is_below(real, root) for root in self.roots):
            raise InputError(f"{path}: {INSIDE}")
        return Path(real)


@dataclass(frozen=True)
class Border:
    """The limits of the names that lists and remotes may give.

    roots : folders whose files may be named.
    live : whether all streams may be named.
    named : streams that the command line names.
    """

    roots: tuple[str, ...] = ()
    live: bool = False
    named: frozenset[str] = field(default_factory=frozenset)

    @classmethod
    def around(cls, media: Iterable[Medium], roots: Iterable[Path], *, live: bool) -> Self:
        """Return the border for a command line: the given roots, the folders and the folders of the files it names."""
        named = [Path(medium.name) for medium in media if medium.live() is None]
        folders = [*roots, *(path if os.path.isdir(path) else path.parent for path in named)]
        absolute = tuple(dict.fromkeys(map(os.path.abspath, folders)))
        return cls(absolute, live, frozenset(medium.name for medium in media if medium.live()))

    def within(self, folder: Path) -> "Border":
        """Return this border, extended by another folder."""
        return replace(self, roots=(*self.roots, os.path.abspath(folder)))

    def medium(self, name: str) -> Medium:
        """Return the medium that a list or a remote names. Medium.check decides whether the name is allowed."""
        stream = live_address(name) is not None and not is_device(name)
        return Medium(name) if stream and (self.live or name in self.named) else Medium(name, self.roots)


def _is_below(real: str, root: str) -> bool:
    folder = os.path.realpath(root)
    return os.path.commonpath([real, folder]) == folder


def _who_may(name: str) -> str:
    if is_device(name):
        return "only the command line may name devices and filters"
    return "not named on the command line; add --allow-live to let lists and remotes name streams"

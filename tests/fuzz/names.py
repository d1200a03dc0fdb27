"""Hostile names of media, and media that name other files: all targets that lists, remotes and films may name."""

import os
import socket
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.media import numbered, write_video
from tests.mutants import mutant
from tests.test_border import FFCONCAT, HLS, SDP, VOBSUB

SCHEMES = (
    *(
        "",
        "",
        "",
        "file:",
        "file://",
        "FILE:",
        "lavfi:",
        "LAVFI:",
        "lavfi:movie=",
        "lavfi:amovie=",
        "concat:",
        "concatf:",
    ),
    *(
        "subfile,,start,0,end,0,,:",
        "data:video/x-matroska;base64,",
        "fd:",
        "pipe:",
        "crypto:",
        "cache:",
        "async:",
        "tee:",
    ),
    *(
        "unix:",
        "unix://",
        "v4l2:",
        "x11grab:",
        "alsa:",
        "pulse:",
        "fbdev:",
        "kmsgrab:",
        "libcdio:",
        "sdp:",
        "hls+file://",
    ),
)
STREAMS = (
    *("http://{here}/x.mkv", "https://{here}/x", "tcp://{here}", "udp://{here}", "udplite://{here}", "rtsp://{here}/x"),
    *("rtp://{here}", "rtmp://{here}/a/b", "srt://{here}", "ftp://{here}/x", "sftp://{here}/x", "gopher://{here}/x"),
    *(
        "mmst://{here}/x",
        "tls://{here}",
        "icecast://{here}/x",
        "ipfs://x",
        "hls+http://{here}/x.m3u8",
        "httpproxy://{here}",
    ),
    *("tcp://{here}?listen=1", "http://{here}/x.mkv?listen=1", "udp://@{here}?reuse=1", "//{here}/share/x.mkv"),
)
TARGETS = (
    *("{outside}/secret.mkv", "../outside/secret.mkv", "./../outside/./secret.mkv", "link.mkv", "folder/secret.mkv"),
    *("{outside}/%02d.png", "../outside/%02d.png", "folder/%02d.png", "l%02d.png", "{outside}", "folder", "{media}/.."),
    *(
        "/etc/hostname",
        "/etc/shadow",
        "/proc/self/environ",
        "/proc/self/fd/0",
        "/proc/self/mem",
        "/dev/stdin",
        "/dev/zero",
    ),
    *(
        "/dev/video0",
        "/dev/tty",
        "/dev/mem",
        "/sys/kernel/profiling",
        "pipe.mkv",
        "socket.mkv",
        "clip.mkv",
        "{media}/clip.mkv",
    ),
    *(
        "",
        ".",
        "~/secret.mkv",
        "$HOME/x",
        "`touch {written}`",
        "$(touch {written})",
        "|touch {written}",
        "; touch {written}",
    ),
    *("testsrc=d=1,metadata=mode=add:key=a:value=b,metadata=mode=print:file={written}", "movie={outside}/secret.mkv"),
    *(
        "testsrc=d=1,drawtext=textfile={outside}/secret.mkv",
        "sendcmd=f={outside}/secret.mkv",
        "azmq=bind=tcp\\://{here}",
    ),
    *(
        "clip.mkv|{outside}/secret.mkv",
        "clip.mkv\x00.png",
        "c*ip.mkv",
        "c?ip.mkv",
        "[a-z]*.mkv",
        "x" * 5000,
        "\u202egpj.mkv",
    ),
)
MPD = (
    '<MPD xmlns="urn:mpeg:dash:schema:mpd:2011"><Period><AdaptationSet><Representation><BaseURL>{}</BaseURL>'
    "</Representation></AdaptationSet></Period></MPD>"
)
IMF = '<CompositionPlaylist xmlns="http://www.smpte-ra.org/schemas/2067-3/2016"><Path>{}</Path></CompositionPlaylist>'
ASX = '<asx version="3.0"><entry><ref href="{}"/></entry></asx>'
SVG = (
    '<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink"><image xlink:href="{}"/></svg>'
)
XXE = '<?xml version="1.0"?><!DOCTYPE x [<!ENTITY y SYSTEM "{}">]><svg>&y;</svg>'
WRAPPERS = (
    *(FFCONCAT, HLS, SDP, VOBSUB, MPD, IMF, ASX, SVG, XXE, "[playlist]\nFile1={}\n", "#EXTM3U\n{}\n", "RIFF{}", "{}\n"),
    '#EXTM3U\n#EXT-X-KEY:METHOD=AES-128,URI="{}"\n#EXTINF:1,\nclip.mkv\n#EXT-X-ENDLIST\n',
    '#EXTM3U\n#EXT-X-MAP:URI="{}"\n#EXTINF:1,\nclip.mkv\n#EXT-X-ENDLIST\n',
    "ffconcat version 1.0\nfile clip.mkv\nfile {}\noption protocol_whitelist file,http,tcp\n",
)
SUFFIXES = (
    *(".mkv", ".mp4", ".mov", ".avi", ".ts", ".png", ".jpg", ".exr", ".svg", ".gif", ".y", ".mpd", ".m3u", ".m3u8"),
    *(".txt", ".hls", ".sdp", ".idx", ".sub", ".mlv", ".ffconcat"),
)


@dataclass(frozen=True)
class Name:
    """A name, and the file of that name in the media folder if the trial creates one."""

    text: str
    content: bytes | None = None


@dataclass(frozen=True)
class Ground:
    """Targets of the names: a media folder, a secret next to it, an address of this machine.

    written : a file that no name may create.
    """

    folder: Path
    here: str

    @property
    def media(self) -> Path:
        return self.folder / "media"

    def filled(self, pattern: str) -> str:
        places = {"outside": self.folder / "outside", "media": self.media, "written": self.folder / "written"}
        return pattern.format(here=self.here, **places)

    def lay(self) -> None:
        """Make the folders, a clip in each, and the links between them."""
        for folder in (self.media, self.folder / "outside"):
            folder.mkdir(parents=True)
        write_video(self.media / "clip.mkv", [numbered(n) for n in range(3)])
        secret = self.folder / "outside" / "secret.mkv"
        secret.write_bytes((self.media / "clip.mkv").read_bytes())
        for number in range(2):
            (self.folder / "outside" / f"{number:02}.png").write_bytes(b"secret")
            (self.media / f"l{number:02}.png").symlink_to(self.folder / "outside" / f"{number:02}.png")
        (self.media / "link.mkv").symlink_to(secret)
        (self.media / "folder").symlink_to(secret.parent)
        os.mkfifo(self.media / "pipe.mkv")
        with socket.socket(socket.AF_UNIX) as listener:
            listener.bind(str(self.media / "socket.mkv"))


def draw_name(ground: Ground, rng: np.random.Generator, index: int) -> Name:
    """Return a name that a client may use to reach beyond the border."""
    target = _target(ground, rng)
    if rng.integers(3):
        return Name(_twisted(target, rng) if not rng.integers(3) else target)
    content = WRAPPERS[rng.integers(len(WRAPPERS))].replace("{}", target).encode("utf-8", "surrogateescape")
    suffix = SUFFIXES[rng.integers(len(SUFFIXES))]
    return Name(f"d{index}{suffix}", mutant(content, "x.txt", rng) if not rng.integers(4) else content)


def _target(ground: Ground, rng: np.random.Generator) -> str:
    if not rng.integers(4):
        return ground.filled(STREAMS[rng.integers(len(STREAMS))])
    return SCHEMES[rng.integers(len(SCHEMES))] + ground.filled(TARGETS[rng.integers(len(TARGETS))])


def _twisted(text: str, rng: np.random.Generator) -> str:
    """Return another spelling of a name, of a kind that filters often miss."""
    twists: tuple[Callable[[str], str], ...] = (
        str.upper,
        lambda t: t.replace("/", "//"),
        lambda t: t.replace("..", "%2e%2e"),
        lambda t: t.replace(":", "%3a", 1),
        lambda t: f" {t}",
        lambda t: f"{t} ",
        lambda t: f"./{t}",
        lambda t: t.replace("/", "\\"),
        lambda t: f'"{t}"',
        lambda t: f"{t}#.png",
        lambda t: f"{t}?.png",
        lambda t: t[: int(rng.integers(len(t) + 1))],
    )
    return twists[rng.integers(len(twists))](text)

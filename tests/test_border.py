"""Limits of trust: the media that a list or a remote may name, and FFmpeg opening no media named inside a medium.

docs/security.md lists these promises. Canaries are files and a port that nothing may touch.
"""

import os
import re
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from counterlight.errors import InputError
from counterlight.media.decoding import opening
from counterlight.media.decoding.audio_decoder import decoded
from counterlight.media.medium import Border, Medium
from counterlight.media.video import MediaReader
from counterlight.show.command_line import read_options
from counterlight.show.playlist import expand, files_of
from tests.canaries import Canary, canary
from tests.media import copies, numbered, write_video
from tests.programs import ROOT

pytestmark = pytest.mark.usefixtures("nothing_is_left")
FFCONCAT = "ffconcat version 1.0\nfile {}\n"
HLS = "#EXTM3U\n#EXT-X-VERSION:3\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\n{}\n#EXT-X-ENDLIST\n"
SDP = "v=0\r\no=- 0 0 IN IP4 127.0.0.1\r\ns=x\r\nc=IN IP4 127.0.0.1\r\nt=0 0\r\nm=video {} RTP/AVP 96\r\n"
VOBSUB = "# VobSub index file, v7 (do not modify this line!)\nsize: 64x48\nid: en, index: 0\n"


@pytest.fixture
def bird() -> Iterator[Canary]:
    with canary() as it:
        yield it


@pytest.fixture
def media(tmp_path: Path) -> Path:
    """Create a folder with a clip, next to a folder with a secret clip."""
    for folder in ("media", "outside"):
        (tmp_path / folder).mkdir()
        write_video(tmp_path / folder / "clip.mkv", [numbered(n) for n in range(5)])
    return tmp_path / "media"


def refusal(medium: Medium) -> str:
    with pytest.raises(InputError) as caught:
        MediaReader.open(medium, tolerant=True).close()
    line = str(caught.value)
    assert "\n" not in line
    return line


def limited(path: Path, *roots: Path) -> Medium:
    return Medium(str(path), tuple(map(str, roots)))


def test_a_name_reaches_as_far_as_who_says_it(media: Path) -> None:
    border = Border.around(
        [Medium(str(media / "clip.mkv")), Medium("udp://127.0.0.1:9"), Medium("lavfi:testsrc")], [], live=False
    )
    assert border.roots == (str(media),)
    assert border.medium("a.mkv") == Medium("a.mkv", (str(media),))
    assert border.medium("udp://127.0.0.1:9") == Medium("udp://127.0.0.1:9")  # named on the command line
    for name in ("udp://127.0.0.1:8", "rtsp://host/x", "lavfi:testsrc", "v4l2:/dev/video0", "x11grab::0"):
        medium = border.medium(name)
        assert medium.live() is None
        with pytest.raises(InputError, match=r"only the command line|not named on the command line"):
            medium.check()
    generous = Border.around([], [media], live=True)
    assert generous.medium("udp://127.0.0.1:8") == Medium("udp://127.0.0.1:8")
    for name in ("lavfi:testsrc", "v4l2:/dev/video0", "x11grab::0"):
        with pytest.raises(InputError, match="only the command line may name devices and filters"):
            generous.medium(name).check()


def test_a_list_reaches_what_is_below_its_folder(media: Path, bird: Canary) -> None:
    (media / "below").mkdir()
    (media / "below" / "deep.mkv").write_bytes((media / "clip.mkv").read_bytes())
    outside = media.parent / "outside" / "clip.mkv"
    (media / "link.mkv").symlink_to(outside)
    (media / "folder").symlink_to(outside.parent)
    (media / "list.m3u").write_text(
        f"clip.mkv\nbelow/deep.mkv\n{media / 'clip.mkv'}\n"
        f"{outside}\n../outside/clip.mkv\nlink.mkv\nfolder/clip.mkv\nfolder/%03d.png\n"
    )
    entries = expand([Medium(str(media / "list.m3u"))], Border())
    for medium in entries[:3]:
        with MediaReader.open(medium) as reader:
            assert len(copies(reader)) == 5
    bird.watch(outside)
    for medium in entries[3:]:
        assert "below its folder or a --media-root only" in refusal(medium)
    assert bird.touched() == set()
    allowed = expand([Medium(str(media / "list.m3u"))], Border((str(outside.parent),)))
    with MediaReader.open(allowed[5]) as reader:
        assert len(copies(reader)) == 5
    assert bird.touched() == {"clip.mkv"}


def test_what_a_list_names_that_is_no_file(media: Path, bird: Canary) -> None:
    pipe = media / "pipe.mkv"
    os.mkfifo(pipe)
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(media / "socket.mkv"))
    written = media / "written"
    lines = [
        f"lavfi:testsrc=d=1,metadata=mode=add:key=a:value=1,metadata=mode=print:file={written}",
        f"lavfi:movie={media / 'clip.mkv'}",
        f"tcp://127.0.0.1:{bird.port}",
        f"http://127.0.0.1:{bird.port}/x.mkv",
        "concat:clip.mkv|clip.mkv",
        "subfile,,start,0,end,0,,:clip.mkv",
        "data:image/png;base64,AAAA",
        "fd:0",
        "pipe:0",
        "unix:socket.mkv",
        f"async:tcp://127.0.0.1:{bird.port}",
        f"cache:http://127.0.0.1:{bird.port}/x.mkv",
        f"tee:file:{written}",
        "crypto:clip.mkv",
        "file:clip.mkv",
        f"FILE:{media / 'clip.mkv'}",
        f"file://{media / 'clip.mkv'}",
        f"LAVFI:movie={media / 'clip.mkv'}",
        f" tcp://127.0.0.1:{bird.port}",
        f"TCP://127.0.0.1:{bird.port}",
        "udp://127.0.0.1:5004?localport=5004",
        "v4l2:/dev/video0",
        "x11grab::0",
        "X11GRAB::0",
        "/dev/zero",
        "/dev/../dev/stdin",
        "/proc/self/fd/0",
        "%2e/clip.mkv",
        "clip.mkv\0.png",
        "pipe.mkv",
        "socket.mkv",
    ]
    (media / "list.txt").write_text("\n".join(lines))
    entries = expand([Medium(str(media / "list.txt"))], Border())
    bird.watch(media / "clip.mkv")
    bird.watch(pipe)
    for medium in entries:
        refusal(medium)
    assert bird.touched() == set()
    assert not written.exists()


Write = Callable[[Path, str], object]


def write_mlv(path: Path, target: str) -> None:
    """Write a Magic Lantern video, which continues in files named .M00, .M01 and so on."""
    path.write_bytes((b"MLVI" + (52).to_bytes(4, "little") + b"v2.0").ljust(4096, b"\0"))


def text(pattern: str) -> Write:
    return lambda path, target: path.write_text(pattern.format(target))


def write_reference_movie(path: Path, target: str) -> None:
    """Write a QuickTime film whose pictures are in another file, named by an alias in its data reference (dref)."""
    write_video(path, [numbered(n) for n in range(3)], codec="libx264")
    data, name, whole = bytearray(path.read_bytes()), target.encode(), f"/x/{target}".encode()
    volume = bytes(4 + 10 + 1 + 27 + 12)
    alias = b"alis" + volume + bytes([len(name)]) + name.ljust(63, b"\0") + bytes(16)
    alias += b"\0\1\0\1" + bytes(16)  # one folder up, one down
    alias += b"\0\2" + len(whole).to_bytes(2, "big") + whole + bytes(len(whole) % 2) + b"\xff\xff\0\0"
    at = data.rindex(b"url ") - 4  # "in this file": 12 bytes
    data[at : at + 12] = (len(alias) + 4).to_bytes(4, "big") + alias
    for box in (b"dref", b"dinf", b"minf", b"mdia", b"trak", b"moov"):
        size = data.rindex(box, 0, at) - 4
        data[size : size + 4] = (int.from_bytes(data[size : size + 4], "big") + len(alias) + 4 - 12).to_bytes(4, "big")
    path.write_bytes(data)


IN_DISGUISE: dict[str, tuple[str, Write, str]] = {
    "ffconcat": ("list.mp4", text(FFCONCAT), "clip.mkv"),
    "hls": ("list.hls", text(HLS), "clip.mkv"),
    "hls-network": ("list.hls", text(HLS), "http://127.0.0.1:{port}/x.ts"),
    "sdp": ("list.mp4", text(SDP), "5004"),
    "vobsub": ("clip.idx", text(VOBSUB), "clip.sub"),
    "mlv": ("clip.mlv", write_mlv, "clip.M00"),
    "planes": ("clip.y", text("{}" + 3000 * "y"), "clip.u"),
    "quicktime": ("film.mov", write_reference_movie, "clip.mkv"),
    "svg": ("clip.svg", text('<svg><image href="{}"/></svg>'), "clip.mkv"),
}


@pytest.mark.parametrize("trusted", [False, True])
@pytest.mark.parametrize("kind", IN_DISGUISE)
def test_a_film_that_is_a_list_opens_nothing(kind: str, trusted: bool, media: Path, bird: Canary) -> None:
    """Neither pictures nor sound open another file, even if a trusted source names the film."""
    name, write, target = IN_DISGUISE[kind]
    for path in (media / "clip.mkv", media / "clip.sub", media / "clip.M00", media / "clip.u"):
        path.write_bytes((media / "clip.mkv").read_bytes())
        bird.watch(path)
    bird.touched()
    write(media / name, target.format(port=bird.port))
    line = refusal(Medium(str(media / name)) if trusted else limited(media / name, media))
    assert re.search("FFmpeg (cannot read it|decodes no picture)", line)
    with suppress(av.FFmpegError, InputError):
        assert not list(decoded(limited(media / name, media), 0.0, 1.0))  # the sound of the film
    assert bird.touched() == set()


def test_the_canary_sings(media: Path, bird: Canary) -> None:
    """Without the product's protection, FFmpeg opens the files in the list, and the canary reports them."""
    (media / "list.mp4").write_text(FFCONCAT.format("clip.mkv"))
    bird.watch(media / "clip.mkv")
    with av.open(f"file:{media / 'list.mp4'}", options={"protocol_whitelist": "file"}) as container:
        assert len(list(container.decode(video=0))) == 5
    assert bird.touched() == {"clip.mkv"}
    write_reference_movie(media / "film.mov", "clip.mkv")
    with suppress(av.FFmpegError), av.open(str(media / "film.mov"), options={"enable_drefs": "1"}) as container:
        list(container.decode(video=0))
    assert bird.touched() == {"clip.mkv"}
    with socket.create_connection(("127.0.0.1", bird.port)):
        assert bird.touched() == {"port"}


def test_a_peer_cannot_send_the_player_elsewhere(bird: Canary) -> None:
    """A stream named on the command line answers with a list of other addresses; the player opens none of them."""
    playlist = HLS.format(f"tcp://127.0.0.1:{bird.port}").encode()
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answer() -> None:
            connection, _ = server.accept()
            connection.sendall(playlist)
            connection.close()

        thread = threading.Thread(target=answer)
        thread.start()
        assert "FFmpeg cannot open it" in refusal(Medium(f"tcp://127.0.0.1:{server.getsockname()[1]}"))
        thread.join()
    assert bird.touched() == set()


def test_a_server_cannot_send_the_player_elsewhere(bird: Canary) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answer() -> None:
            connection, _ = server.accept()
            # answers to OPTIONS and DESCRIBE
            for status in ("200 OK", f"302 Found\r\nLocation: rtsp://127.0.0.1:{bird.port}/x"):
                number = re.search(rb"CSeq: (\d+)", connection.recv(4096))
                assert number is not None
                connection.sendall(f"RTSP/1.0 {status}\r\nCSeq: {number[1].decode()}\r\n\r\n".encode())
            connection.recv(4096)
            connection.close()

        thread = threading.Thread(target=answer)
        thread.start()
        assert "FFmpeg cannot open it" in refusal(Medium(f"rtsp://127.0.0.1:{server.getsockname()[1]}/x"))
        thread.join()
    assert bird.touched() == set()


def test_numbered_pictures_stay_inside_too(media: Path, bird: Canary) -> None:
    for index in range(3):
        cv2.imwrite(str(media / f"{index:03}.png"), np.full((8, 9, 3), index, np.uint8))
    with MediaReader.open(limited(media / "%03d.png", media)) as reader:
        assert len(copies(reader)) == 3
    outside = media.parent / "outside" / "x.png"
    (media / "001.png").rename(outside)
    (media / "001.png").symlink_to(outside)
    bird.watch(outside)
    assert "below its folder or a --media-root only" in refusal(limited(media / "%03d.png", media))
    (media / "001.png").unlink()
    os.mkfifo(media / "001.png")
    assert "not a regular file" in refusal(limited(media / "%03d.png", media))
    assert bird.touched() == set()


def test_only_what_was_looked_at_is_opened_of_numbered_pictures(media: Path, bird: Canary) -> None:
    """The product may find picture 7 as 07, but FFmpeg opens 7, so the check must follow the link 7.png."""
    for folder, name in (("media", "07.png"), ("media", "007.png"), ("outside", "7.png")):
        cv2.imwrite(str(media.parent / folder / name), np.full((8, 9, 3), 7, np.uint8))
    (media / "7.png").symlink_to(bird.watch(media.parent / "outside" / "7.png"))
    assert "below its folder or a --media-root only" in refusal(limited(media / "%d.png", media))
    assert bird.touched() == set()


def test_a_sequence_beyond_the_border_is_not_even_counted(media: Path, bird: Canary) -> None:
    outside = media.parent / "outside"
    for index in range(2):
        (outside / f"{index:03}.png").write_bytes(b"secret")
    pattern = outside / "%03d.png"
    assert len(files_of(Medium(str(pattern)))) == 2
    bird.watch(outside)
    assert files_of(limited(pattern, media)) == []
    assert bird.touched() == set()
    assert len(files_of(Medium(str(pattern)))) == 2
    assert bird.touched() == {"outside"}  # the canary works


@pytest.mark.parametrize("name", ["a%03d.png", "a?.png", "a{1}.png", "a*.png", "a:b.png"])
def test_a_name_that_looks_like_a_pattern_is_one_file(name: str, media: Path, bird: Canary) -> None:
    for each in (name, "a001.png", "ab.png", "a1.png"):
        cv2.imwrite(str(media / each), np.full((8, 9, 3), 7, np.uint8))
        if each != name:
            bird.watch(media / each)
    bird.touched()
    with MediaReader.open(limited(media / name, media)) as reader:
        assert len(copies(reader)) == 1
    assert bird.touched() == set()


def test_options_draw_the_border(media: Path, tmp_path: Path) -> None:
    (media / "list.m3u").write_text("udp://127.0.0.1:5004\nclip.mkv\n")
    config = tmp_path / "player.toml"
    config.write_text(f'media-root = ["{tmp_path / "a"}", "{tmp_path / "b"}"]\nallow-live = true\n')
    for name in "ab":
        (tmp_path / name).mkdir()
    options = read_options(["room", str(media / "list.m3u"), "--config", str(config)], "")
    roots = str(tmp_path / "a"), str(tmp_path / "b"), str(media)
    assert options.border == Border(roots, True, frozenset())
    assert options.media == [Medium("udp://127.0.0.1:5004"), Medium(str(media / "clip.mkv"), (*roots, str(media)))]
    words = ["room", str(media / "list.m3u"), "--no-config", "--media-root", str(tmp_path)]
    options = read_options(words, "")
    assert options.border == Border((str(tmp_path), str(media)), False, frozenset())
    assert options.media[0] == Medium("udp://127.0.0.1:5004", (*options.border.roots, str(media)))
    assert not any(action in options for action in ("media_roots", "live"))


def test_folders_that_a_list_may_not_name_are_not_listed(media: Path, bird: Canary) -> None:
    """The check whether an output is among the played files lists no such folder either."""
    (media / "list.m3u").write_text("../outside/%d.mkv\n../outside/clip.mkv\nclip.mkv\n")
    bird.watch(media.parent / "outside")
    options = read_options(["room", str(media / "list.m3u"), "--no-config"], "")
    assert [path for medium in options.media for path in files_of(medium)] == [media / "clip.mkv"]
    assert bird.touched() == set()


def test_every_opening_of_the_player_goes_through_one_door() -> None:
    """Only one place calls `av.open` for reading, and sets both of FFmpeg's white lists; no tool calls it."""
    calls = {
        path.relative_to(ROOT).as_posix(): re.findall(r"\bav\.open\(([^)]*)\)", path.read_text())
        for folder in ("player", "tools")
        for path in (ROOT / folder).rglob("*.py")
    }
    calls = {path: found for path, found in calls.items() if found}
    writers = "player/show/output.py", "player/media/decoding/sound_copier.py"
    assert calls.keys() == {"player/media/decoding/opening.py", *writers}
    (reading,) = calls["player/media/decoding/opening.py"]
    assert "options={**options, **whitelists}" in reading
    for (writing,) in map(calls.__getitem__, writers):
        assert '"w"' in writing
    nested = {"concat", "hls", "dash", "imf", "sdp", "rtsp", "rtp", "vobsub", "mlv", "lavfi", "image2", "svg_pipe"}
    assert nested & set(opening.FORMATS.split(",")) == set()

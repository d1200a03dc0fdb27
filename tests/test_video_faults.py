"""Broken media, files that are no media, and dying decoders: player/media/video.py reports them and continues."""

import os
import re
import signal
import socket
import struct
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from counterlight.errors import InputError
from counterlight.media.decoding.child import MAX_ADDRESS_SPACE
from counterlight.media.video import MediaReader
from tests.media import (
    RATE,
    SHARED,
    TIME_TOLERANCE_S,
    TIMEOUT_S,
    copies,
    next_frame,
    number,
    numbered,
    read,
    until_error,
    write_h264,
    write_jpeg,
    write_picture,
    write_video,
)
from tests.programs import ROOT, is_running

pytestmark = pytest.mark.usefixtures("nothing_is_left")
_NOTES = {".json", ".upstream", ".pillow"}
# headers of pictures with 9000 x 9000 pixels
PNG_HEADER = b"\x89PNG\r\n\x1a\n" + struct.pack(">I4sIIBBBBBI", 13, b"IHDR", 9000, 9000, 8, 2, 0, 0, 0, 0)
TIFF_TAGS = {256: 9000, 257: 9000, 258: 8, 259: 1, 262: 1, 273: 8, 277: 1, 278: 9000, 279: 99}
TIFF_INDEX = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in TIFF_TAGS.items())
TIFF_HEADER = b"II*\0" + struct.pack("<IH", 8, len(TIFF_TAGS)) + TIFF_INDEX + bytes(4)
HOSTILE = sorted(path for path in (SHARED / "hostile").glob("*/*") if path.suffix not in _NOTES)


def test_size_change_is_named(tmp_path: Path) -> None:
    first = write_video(tmp_path / "a.ts", [numbered(n) for n in range(6)], codec="mpeg2video")
    second = write_video(tmp_path / "b.ts", [numbered(n, 48, 64) for n in range(6)], codec="mpeg2video", first_pts=6)
    both = tmp_path / "both.ts"
    both.write_bytes(first.read_bytes() + second.read_bytes())
    with MediaReader.open(both) as reader:
        numbers, error = until_error(reader)
        assert re.search(r"frame \d+ is 64x48, expected 46x34", error)
        with pytest.raises(InputError, match="re-encode"):  # the failure persists
            reader.next_frame(TIMEOUT_S)
    assert len(numbers) in (5, 6)  # FFmpeg's MPEG-2 decoder may drop its delayed picture when the size changes


@pytest.mark.parametrize("name", ["clip.mp4", "clip.mkv"])
def test_truncated_video_gives_its_frames_then_an_error(name: str, tmp_path: Path) -> None:
    path = write_h264(
        tmp_path / name, 100, container_options={"movflags": "faststart"} if name.endswith("mp4") else None
    )
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * 6 // 10])
    with MediaReader.open(path) as reader:
        numbers, error = until_error(reader)
    assert re.search(r"ends early|cannot be decoded", error)
    assert numbers == [n % 25 for n in range(len(numbers))]
    assert 20 < len(numbers) < 90


@pytest.mark.parametrize("fraction", [0.3, 0.6, 0.95])
@pytest.mark.parametrize("kind", ["jpg", "png", "gif"])
def test_truncated_picture_is_refused(kind: str, fraction: float, tmp_path: Path, rng: np.random.Generator) -> None:
    path = tmp_path / f"p.{kind}"
    if kind == "jpg":
        write_jpeg(path)
    elif kind == "png":
        write_picture(path, (rng.integers(0, 256, (31, 45, 3)).astype(np.uint8),), "rgb24", "png")
    else:
        write_video(path, [(rng.integers(0, 256, (31, 45)).astype(np.uint8),)], pixel_format="gray", codec="gif")
    assert len(read(path)) == 1
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * fraction)])
    with pytest.raises(InputError) as refusal:
        read(path)
    assert str(path) in str(refusal.value)


@pytest.mark.parametrize("cause", [signal.SIGKILL, signal.SIGSEGV, signal.SIGSTOP])
def test_killed_decoder_is_replaced_without_losing_a_frame(cause: signal.Signals, tmp_path: Path) -> None:
    path = write_h264(tmp_path / "clip.mp4", 40)
    with MediaReader.open(path) as reader:
        before = copies(reader, 15)
        held = next_frame(reader)
        os.kill(reader.decoder_pid, cause)
        found = [*before, (held.time_s, tuple(plane.copy() for plane in held.planes)), *copies(reader)]
        reader.release(held)  # a frame of a decoder that has ended
        (notice,) = reader.notices()
    assert [number(planes) for _, planes in found] == [n % 25 for n in range(40)]
    np.testing.assert_allclose([t for t, _ in found], np.arange(40) / RATE, atol=TIME_TOLERANCE_S, rtol=0)
    assert "decoder" in notice
    assert "restarted" in notice


def until_ready(reader: MediaReader) -> None:
    """Poll without waiting, as a show does, until the first frame is there."""
    deadline = time.monotonic() + TIMEOUT_S
    while not reader.ready():
        assert time.monotonic() < deadline
        time.sleep(0.01)


@pytest.mark.parametrize("cause", [signal.SIGSTOP, signal.SIGKILL])
def test_a_decoder_that_never_gives_a_sign_of_life(cause: signal.Signals, tmp_path: Path) -> None:
    """A decoder stopped at its start is replaced.

    If it is killed while opening the medium, the medium is reported as the cause.
    """
    with MediaReader.begin(write_h264(tmp_path / "clip.mp4", 40)) as reader:
        os.kill(reader.decoder_pid, cause)
        if cause == signal.SIGKILL:
            with pytest.raises(InputError, match=r"signal 9, SIGKILL.* while opening it"):
                until_ready(reader)
            return
        until_ready(reader)
        assert len(copies(reader)) == 40
        (notice,) = reader.notices()
    assert "decoder hung after" in notice


def test_a_decoder_is_bounded_and_its_medium_is_nobody_elses_to_know(tmp_path: Path) -> None:
    with MediaReader.open(write_h264(tmp_path / "clip.mp4", 40)) as reader:
        process = Path(f"/proc/{reader.decoder_pid}")
        limits = {line[:25].strip(): line.split()[-3:-1] for line in (process / "limits").read_text().splitlines()}
        assert limits["Max address space"][0] == str(MAX_ADDRESS_SPACE)
        assert limits["Max core file size"][0] == "0"
        assert b"clip" not in (process / "cmdline").read_bytes()  # every user can read the command line


def test_a_medium_that_does_not_open_in_its_time_is_refused_and_its_decoder_ended() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        name = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        with MediaReader.begin(name, opening_s=0.5) as reader:
            with pytest.raises(InputError, match=f"{name}: not opened within 0.5 s"):
                until_ready(reader)
            reader.close()
            reader.close()  # closing twice is harmless


def test_frames_of_a_reader_that_was_begun_are_those_of_one_that_was_opened(tmp_path: Path) -> None:
    with MediaReader.begin(write_h264(tmp_path / "clip.mp4", 40)) as reader:
        until_ready(reader)
        until_ready(reader)
        assert [number(planes) for _, planes in copies(reader)] == [n % 25 for n in range(40)]
        assert reader.ready()  # also at its end
        reader.seek(0.0)
        until_ready(reader)
        reader.seek(1.0)
        assert number(next_frame(reader).planes) == 0  # this is picture 25 of the file


def test_decoder_killed_in_a_later_lap_keeps_the_time(tmp_path: Path) -> None:
    with MediaReader.open(write_h264(tmp_path / "clip.mp4", 12), loop=True) as reader:
        found = copies(reader, 30)
        os.kill(reader.decoder_pid, signal.SIGKILL)
        found += copies(reader, 30)
    assert [number(planes) for _, planes in found] == [n % 12 for n in range(60)]
    np.testing.assert_allclose([t for t, _ in found], np.arange(60) / RATE, atol=TIME_TOLERANCE_S, rtol=0)


def test_medium_that_always_kills_the_decoder_is_an_error(tmp_path: Path) -> None:
    """The file vanishes, so that no new decoder can open it."""
    path = write_h264(tmp_path / "clip.mp4", 40)
    with MediaReader.open(path) as reader:
        path.unlink()
        os.kill(reader.decoder_pid, signal.SIGKILL)
        with pytest.raises(InputError, match="no such file"):
            copies(reader)
        with pytest.raises(InputError, match="no such file"):
            reader.poll()


def test_decoder_ends_with_its_parent(tmp_path: Path) -> None:
    path = write_h264(tmp_path / "clip.mp4", 40)
    code = f"""
import os
from counterlight.media.video import MediaReader
reader = MediaReader.open({str(path)!r}, loop=True)
print(reader.decoder_pid, flush=True)
os._exit(0)
"""
    ended = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    decoder = int(ended.stdout)
    deadline = time.monotonic() + TIMEOUT_S
    while is_running(decoder) and time.monotonic() < deadline:
        time.sleep(0.01)
    assert not is_running(decoder)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("absent.mp4", None, "no such file"),
        ("empty.mp4", b"", "empty"),
        ("text.mp4", b"Dear reader,\n" * 40, "cannot read it .*; it is of an unknown kind or begins damaged"),
        ("a b.heic", bytes(4) + b"ftypheic" + bytes(99), "HEIC .* for example: heif-convert 'a b.heic' 'a b.png'"),
        ("large.png", PNG_HEADER, "large.png: claims 9000x9000 pixels, at most 67108864 are shown; scale it down"),
        ("large.tif", TIFF_HEADER + bytes(99), "large.tif: more than 67108864 pixels, or its size is damaged"),
        ("text.txt", b"Dear reader,\n" * 40, "no video or picture|cannot read it"),
        ("text.exr", b"Dear reader,\n" * 40, "not a readable OpenEXR"),
        ("frames-%04d.png", None, "no file matches"),
    ],
)
def test_what_is_no_medium_is_refused(name: str, content: bytes | None, message: str, tmp_path: Path) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=message) as refusal:
        MediaReader.open(path)
    assert str(path) in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_folder_and_audio_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is a folder"):
        MediaReader.open(tmp_path)
    path = tmp_path / "sound.wav"
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream("pcm_s16le", rate=8000, layout="mono")
        sound = av.AudioFrame.from_ndarray(np.zeros((1, 8000), np.int16), format="s16", layout="mono")
        sound.sample_rate = 8000
        container.mux(stream.encode(sound))
        container.mux(stream.encode(None))
    with pytest.raises(InputError, match="holds no video"):
        MediaReader.open(path)


if HOSTILE:

    @pytest.mark.parametrize("path", HOSTILE, ids=lambda path: path.name)
    def test_hostile_file_gives_frames_or_one_line(path: Path) -> None:
        try:
            assert read(path)
        except InputError as error:
            line = str(error)
            assert str(path) in line
            assert "\n" not in line
            assert "decoder stopped" not in line  # refused, without a crash

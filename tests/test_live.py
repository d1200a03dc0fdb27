"""Live sources: FFmpeg's own filters and a UDP stream replace cameras."""

import contextlib
import os
import signal
import socket
import threading
import time
from fractions import Fraction
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Self

import av
import numpy as np
import pytest

from counterlight.errors import InputError
from counterlight.media import video
from counterlight.media.decoding.laps import LIVE_SLOTS
from counterlight.media.medium import Border, LiveAddress, Medium, live_address
from counterlight.media.video import MAX_DEATHS, Frame, MediaReader
from counterlight.show.playback import Playback
from counterlight.show.playlist import expand
from tests.ffmpeg_frames import ffmpeg_frame
from tests.stage import Reader, Stage

TIMEOUT_S = 30.0
# luma is the picture's number
COUNTING = "nullsrc=size=64x48:rate=25,format=yuv420p,geq=lum='mod(N,200)':cb=128:cr=128"


def next_frame(reader: MediaReader) -> Frame:
    frame = reader.next_frame(TIMEOUT_S)
    assert frame is not None
    return frame


def test_what_is_live() -> None:
    assert live_address("v4l2:/dev/video0") == LiveAddress("/dev/video0", "v4l2", "file")
    assert live_address("lavfi:testsrc=size=64x48") == LiveAddress("testsrc=size=64x48", "lavfi", "file")
    for address, protocols in (
        ("rtsp://camera/stream", "rtp,srtp,udp,tcp"),
        ("udp://@239.0.0.1:5000", "udp"),
        ("srt://host:9000", "srt"),
    ):
        assert live_address(address) == LiveAddress(address, None, protocols)
        assert expand([Medium(address)], Border()) == [Medium(address)]
    for name in ("clip.mp4", "/dev/video99", "v4l2:", "C:/film.mp4", "https://host/film.mp4", "udp.mp4"):
        assert live_address(name) is None


def test_addresses_in_a_list_are_not_paths(tmp_path: Path) -> None:
    (tmp_path / "list.txt").write_text("lavfi:testsrc\nrtsp://camera/1\nclip.mp4\n")
    found = expand([Medium(str(tmp_path / "list.txt"))], Border())
    assert [medium.name for medium in found] == ["lavfi:testsrc", "rtsp://camera/1", str(tmp_path / "clip.mp4")]


def test_pictures_come_without_end_at_the_time_of_their_arrival() -> None:
    start = time.monotonic()
    with MediaReader.open(f"lavfi:{COUNTING}", loop=True) as reader:
        assert (reader.info.live, reader.info.still, reader.info.duration_s) == (True, False, None)
        assert str(reader.info.path) == f"lavfi:{COUNTING}"
        times, numbers = [], []
        for _ in range(20):
            frame = next_frame(reader)
            times.append(frame.time_s)
            numbers.append(int(frame.planes[0][0, 0]))
            reader.release(frame)
        assert not reader.ended
    assert times == sorted(set(times))
    assert numbers == sorted(set(numbers))
    # paced: frames never come faster than the source's rate, however busy the machine is
    assert time.monotonic() - start >= 17 / 25


def test_the_newest_picture_counts_for_whoever_is_busy() -> None:
    """The source runs on while all slots are held. The next frame shown is the newest."""
    with MediaReader.open(f"lavfi:{COUNTING}") as reader:
        held = [next_frame(reader) for _ in range(LIVE_SLOTS)]
        time.sleep(1.0)
        for frame in held:
            reader.release(frame)
        frame = next_frame(reader)
        assert int(frame.planes[0][0, 0]) - int(held[-1].planes[0][0, 0]) >= 20
        assert frame.skipped >= 20
        assert frame.time_s - held[-1].time_s >= 0.9


def test_an_old_picture_waits_for_the_newest() -> None:
    """A reader without a poll for a second fills its slots with old pictures. None of them is shown."""
    with MediaReader.open(f"lavfi:{COUNTING}") as reader:
        playback = Playback(reader, time.monotonic)

        def due() -> Frame:
            until = time.monotonic() + TIMEOUT_S
            while time.monotonic() < until:
                if (frame := playback.due()) is not None:
                    return frame
                time.sleep(0.001)
            raise AssertionError("no frame is due")

        last = 0.0
        for _ in range(10):
            frame = due()
            last = frame.time_s
            reader.release(frame)
        time.sleep(1.0)
        assert due().time_s - last >= 0.9
        assert playback.dropped + 11 >= 25
        playback.seek(3)  # a live source cannot go back
        assert due().time_s > last


def test_a_reader_that_is_asked_to_seek_goes_on() -> None:
    with MediaReader.open(f"lavfi:{COUNTING}") as reader:
        frame = next_frame(reader)
        reader.release(frame)
        reader.seek(0.0)
        assert next_frame(reader).time_s > frame.time_s


def test_a_source_that_breaks_off_is_opened_again() -> None:
    with MediaReader.open(f"lavfi:{COUNTING},trim=end_frame=5") as reader:
        numbers: list[int] = []
        while len(numbers) < 12:
            frame = next_frame(reader)
            numbers.append(int(frame.planes[0][0, 0]))
            reader.release(frame)
        lost, back = reader.notices()[:2]
    assert numbers == [1, 2, 3, 4] * 3  # `nobuffer`: pictures that FFmpeg reads to recognise the stream are not shown
    assert lost.endswith("lost (it ended); reconnecting")
    assert back.endswith("back")


def udp_port() -> int:
    """Return a UDP port that is free now."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class Sender:
    """Sends grey pictures of one size to a UDP port, 25 per second, until the block ends.

    loss : share of packets that a relay drops.
    lost : number of dropped packets.
    """

    def __init__(self, port: int, size: tuple[int, int] = (64, 48), *, loss: float = 0.0, codec: str = "mpeg2video"):
        self._size, self._codec, self._loss, self.lost = size, codec, loss, 0
        self._stop, self._relay = threading.Event(), socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._relay.bind(("127.0.0.1", 0))
        self._relay.settimeout(0.1)
        self._port = port
        self._threads = [threading.Thread(target=self._send)]
        self._threads += [threading.Thread(target=self._forward)] if loss else []

    def __enter__(self) -> Self:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        for thread in self._threads:
            thread.join()
        self._relay.close()

    def _forward(self) -> None:
        rng = np.random.default_rng(20060504)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
            while not self._stop.is_set():
                with contextlib.suppress(TimeoutError):
                    packet = self._relay.recv(1 << 16)
                    if rng.random() < self._loss:
                        self.lost += 1
                    else:
                        out.sendto(packet, ("127.0.0.1", self._port))

    def _send(self) -> None:
        port = self._relay.getsockname()[1] if self._loss else self._port
        width, height = self._size
        rng = np.random.default_rng(20060504)
        textures = rng.integers(0, 60 if self._loss else 1, (5, height, width), np.uint8)
        neutral = np.full((height // 2, width // 2), 128, np.uint8)
        with av.open(f"udp://127.0.0.1:{port}?pkt_size=1316", "w", format="mpegts") as container:
            stream: Any = container.add_stream(self._codec, rate=25, options={"g": "5"})
            stream.height, stream.width, stream.pix_fmt = height, width, "yuv420p"
            for i in count():
                frame = ffmpeg_frame((120 + textures[i % 5], neutral, neutral), "yuv420p")
                frame.pts, frame.time_base = i, Fraction(1, 25)
                container.mux(stream.encode(frame))
                if self._stop.wait(0.04):
                    break


def test_a_stream_over_udp() -> None:
    port = udp_port()
    with Sender(port), MediaReader.open(f"udp://127.0.0.1:{port}") as reader:
        frame = next_frame(reader)
        assert (reader.info.format.width, reader.info.format.height) == (64, 48)
        assert reader.info.live
        np.testing.assert_allclose(frame.planes[0][:, :64], 120, atol=2)  # MPEG-2 of a flat grey


@pytest.mark.parametrize("codec", ["mpeg2video", "libx264"])
def test_lost_packets_cost_pictures_and_never_the_show(codec: str) -> None:
    """One packet in thirty is lost, and two or three pictures share a packet. The complete pictures are shown."""
    port, shown, skipped = udp_port(), 0, 0
    with (
        Sender(port, (320, 240), loss=0.03, codec=codec) as sender,
        MediaReader.open(f"udp://127.0.0.1:{port}") as reader,
    ):
        while shown < 50 or sender.lost < 10 or not skipped:
            frame = next_frame(reader)
            shown, skipped = shown + 1, skipped + frame.skipped
            reader.release(frame)
        assert not reader.ended
        assert [line for line in reader.notices() if "damaged pictures are left out" in line]


def test_a_stream_that_changes_its_size_is_opened_again() -> None:
    """The sender restarts with larger pictures: frames of the new format arrive, and their times continue."""
    port = udp_port()
    with MediaReader.begin(f"udp://127.0.0.1:{port}") as reader:
        with Sender(port, (64, 48)):
            first = next_frame(reader)
            assert (first.format.width, first.format.height) == (64, 48)
            reader.release(first)
        with Sender(port, (128, 96)):
            frame = next_frame(reader)
            while frame.format.width == 64:
                reader.release(frame)
                frame = next_frame(reader)
            assert (frame.format.width, frame.format.height) == (128, 96)
            assert frame.planes[0].shape[0] == 96
            assert reader.info.format == frame.format
            assert frame.time_s > first.time_s
            reader.release(frame)
            later = next_frame(reader)
            assert later.time_s > frame.time_s
        assert any("128x96, expected 64x48; opened again" in line for line in reader.notices())


def test_a_decoder_of_a_live_source_is_replaced_as_often_as_it_takes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(video, "LIVE_RETRY_S", (0.0, 0.1))
    with MediaReader.open(f"lavfi:{COUNTING}") as reader:
        last_s = 0.0
        for _ in range(MAX_DEATHS + 1):
            os.kill(reader.decoder_pid, signal.SIGKILL)
            number = reader.decoder_pid
            while reader.decoder_pid == number:
                if (frame := reader.poll()) is not None:
                    last_s = frame.time_s
                    reader.release(frame)
        frame = next_frame(reader)
        assert frame.time_s > last_s
        assert len(reader.notices()) == MAX_DEATHS + 1


def test_frames_of_another_format_are_drawn_as_such() -> None:
    stage = Stage(Reader(count=1000))
    stage.advance(0.2)
    opened = stage.screen.opened
    stage.reader.info.format = SimpleNamespace(width=8, height=6)
    stage.advance(0.2)
    assert stage.screen.opened == opened + 1
    assert not stage.session.done


@pytest.mark.parametrize("name", ["lavfi:no_such_filter", "rtsp://127.0.0.1:9/stream", "v4l2:/dev/video99"])
def test_what_cannot_be_opened_is_reported_in_one_line(name: str) -> None:
    with pytest.raises(InputError, match="check the address") as raised:
        MediaReader.open(name)
    assert str(raised.value).startswith(f"{name}: FFmpeg cannot open it (")
    assert "\n" not in str(raised.value)


def test_seeking_and_stepping_back_leave_a_live_source_alone() -> None:
    stage = Stage(Reader(count=1000), speed=1.0)
    stage.reader.info.live, stage.reader.info.duration_s = True, None
    stage.show.step()
    shown = stage.screen.uploaded[-1]
    stage.press("left", "down", ",")
    assert stage.reader.position > shown
    assert stage.screen.uploaded == sorted(stage.screen.uploaded)


def test_a_screen_is_shown_as_it_is(xvfb: str) -> None:
    """docs/content.md: a medium can be another program's screen."""
    with MediaReader.open(f"x11grab:{xvfb}") as reader:
        frame = next_frame(reader)
        pixels = frame.format
        assert (reader.info.live, pixels.layout, pixels.depth) == (True, "rgb", 8)
        assert (pixels.height, pixels.width) == (720, 1280)
        reader.release(frame)

"""Live sources: FFmpeg's own filters and a stream over UDP stand for the cameras that are not here."""

import socket
import threading
import time
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from player.decoding.laps import LIVE_SLOTS
from player.decoding.live import LiveAddress, live_address
from player.errors import InputError
from player.medium import Border, Medium
from player.show.playback import Playback
from player.show.playlist import expand
from player.show.session_inputs import Setup
from player.video import Frame, MediaReader
from tests.ffmpeg_frames import ffmpeg_frame
from tests.stage import Reader, Stage

TIMEOUT_S = 30.0
COUNTING = "nullsrc=size=64x48:rate=25,format=yuv420p,geq=lum='mod(N,200)':cb=128:cr=128"  # luma says which picture


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
    assert time.monotonic() - start >= 17 / 25  # paced: never faster than the source's rate, however busy the machine


def test_the_newest_picture_counts_for_whoever_is_busy() -> None:
    """While the slots are held the source runs on; what comes after is what it shows then."""
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
    """Nobody asks for a second: the slots hold pictures that are over by then, and none of them is shown."""
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
        playback.seek(3)  # nothing to go back to
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
    assert numbers == [1, 2, 3, 4] * 3  # `nobuffer`: what FFmpeg read to know the stream is not shown
    assert lost.endswith("lost (it ended); reconnecting")
    assert back.endswith("back")


def test_a_stream_over_udp() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    stop = threading.Event()
    sender = threading.Thread(target=send, args=(f"udp://127.0.0.1:{port}?pkt_size=1316", stop))
    sender.start()
    try:
        with MediaReader.open(f"udp://127.0.0.1:{port}") as reader:
            frame = next_frame(reader)
            assert (reader.info.format.width, reader.info.format.height) == (64, 48)
            assert reader.info.live
            np.testing.assert_allclose(frame.planes[0][:, :64], 120, atol=2)  # MPEG-2 of one flat grey
    finally:
        stop.set()
        sender.join()


def send(address: str, stop: threading.Event) -> None:
    """A flat grey picture, 25 times a second until told to stop."""
    neutral = np.full((24, 32), 128, np.uint8)
    with av.open(address, "w", format="mpegts") as container:
        stream: Any = container.add_stream("mpeg2video", rate=25, options={"g": "5"})
        stream.height, stream.width, stream.pix_fmt = 48, 64, "yuv420p"
        for i in range(1 << 30):
            frame = ffmpeg_frame((np.full((48, 64), 120, np.uint8), neutral, neutral), "yuv420p")
            frame.pts, frame.time_base = i, Fraction(1, 25)
            container.mux(stream.encode(frame))
            if stop.wait(0.04):
                break


@pytest.mark.parametrize("name", ["lavfi:no_such_filter", "rtsp://127.0.0.1:9/stream", "v4l2:/dev/video99"])
def test_what_cannot_be_opened_is_told_in_one_line(name: str) -> None:
    with pytest.raises(InputError, match="check the address") as raised:
        MediaReader.open(name)
    assert str(raised.value).startswith(f"{name}: FFmpeg cannot open it (")
    assert "\n" not in str(raised.value)


def test_seeking_and_stepping_back_leave_a_live_source_alone() -> None:
    stage = Stage(Reader(count=1000), setup=Setup(speed=1.0))
    stage.reader.info.live, stage.reader.info.duration_s = True, None
    stage.session.step()
    shown = stage.screen.uploaded[-1]
    stage.press("left", "down", ",")
    assert stage.reader.position > shown
    assert stage.screen.uploaded == sorted(stage.screen.uploaded)

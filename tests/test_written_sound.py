"""Sound of written films: the source's own packets, in step with the pictures, or a line with the reason."""

from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from tests.ffmpeg_frames import ffmpeg_frame
from tests.media import RATE, numbered, write_video
from tests.programs import command, succeed
from tests.rooms import write_blurred_room

SAMPLES = 48_000  # per second
FRAMES = 40
FIRST = 7  # frames before the first picture: a source's clock need not begin at 0
TIME_TOLERANCE_S = 1e-3  # Matroska counts milliseconds


def write_film(path: Path, codec: str) -> Path:
    """Write the pictures of tests.media and a rising tone that starts before the first picture."""
    with av.open(str(path), "w") as container:
        video: Any = container.add_stream("libx264", rate=RATE, options={"qp": "0"})
        video.height, video.width, video.pix_fmt = 34, 46, "yuv420p"
        audio: Any = container.add_stream(codec, rate=SAMPLES)
        audio.layout = "stereo"
        for i in range(FRAMES):
            frame = ffmpeg_frame(numbered(i % 25), "yuv420p")
            frame.pts, frame.time_base = FIRST + i, Fraction(1, RATE)
            container.mux(video.encode(frame))
            if i % 5 == 0:
                container.mux(audio.encode(tone(i, audio.format.name)))
        container.mux(audio.encode(None))
        container.mux(video.encode(None))
    return path


def tone(i: int, kind: str) -> av.AudioFrame:
    """Return a fifth of a second of sound."""
    time = (np.arange(SAMPLES // 5) + i * SAMPLES // RATE) / SAMPLES
    pairs = np.stack([np.sin(2 * np.pi * (300 + 200 * time) * time)] * 2).astype(np.float32) / 2
    whole = av.AudioFrame.from_ndarray(pairs, format="fltp", layout="stereo")
    whole.sample_rate, whole.pts, whole.time_base = SAMPLES, i * SAMPLES // RATE, Fraction(1, SAMPLES)
    return whole


def sound(path: Path) -> list[tuple[float, bytes]]:
    """Return packets and their times relative to the first picture."""
    with av.open(str(path)) as container:
        first = next(container.decode(video=0)).time
    with av.open(str(path)) as container:
        packets = [each for each in container.demux(audio=0) if each.size] if container.streams.audio else []
        return [(float(each.pts * each.time_base) - first, bytes(each)) for each in packets]


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sound") / "room"
    write_blurred_room(folder, np.random.default_rng(11))
    succeed("build", folder, "--inverse", "none")
    return folder


def play(room: Path, film: Path, output: Path, *words: object) -> str:
    """Play without compensation; return the printed text."""
    options = *("--no-compensation", "--backend", "cpu", "--refine", "0"), "--output", output, *words
    done = command("play", room, film, *options)
    assert done.returncode == 0, done.stderr
    return done.stderr


@pytest.mark.parametrize(
    ("codec", "source", "output", "words"),
    [
        ("aac", "film.mp4", "out.mp4", ()),
        ("mp3", "film.mkv", "out.mkv", ("--start", "0.6", "--frames", "20")),
        ("libopus", "film.mkv", "out.webm", ("--start", "0.4", "--segments", "2")),
        ("ac3", "film.mkv", "out.mov", ("--frames", "30")),
    ],
)
def test_packets_are_the_sources_at_the_pictures_times(
    room: Path, tmp_path: Path, codec: str, source: str, output: str, words: tuple[str, ...]
) -> None:
    film = write_film(tmp_path / source, codec)
    options = dict(zip(words[::2], words[1::2], strict=True))
    start = float(options.get("--start", 0))
    length = min(float(options.get("--frames", FRAMES)), FRAMES - start * RATE) / RATE
    play(room, film, tmp_path / output, *words)
    every, found = sound(film), sound(tmp_path / output)
    margin = 2 * TIME_TOLERANCE_S
    wanted = [(time - start, data) for time, data in every if start + margin < time < start + length - margin]
    assert len(wanted) > 5
    by_data = {data: time for time, data in found}
    assert all(by_data[data] == pytest.approx(time, abs=margin) for time, data in wanted)
    assert [time for time, _ in found if not -margin <= time <= length + margin] == []
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted({source, output})


def test_what_is_not_copied_is_said(room: Path, tmp_path: Path) -> None:
    film = write_film(tmp_path / "film.mp4", "aac")
    assert "webm holds no aac sound; the output has none, .mkv takes it" in play(
        room, film, tmp_path / "o.webm", "--frames", "2"
    )
    assert "--loop: sound is copied once around only" in play(room, film, tmp_path / "o.mp4", "--loop", "--frames", "2")
    assert play(room, film, tmp_path / "o.mkv", "--no-audio", "--frames", "2") == ""
    assert play(room, film, tmp_path / "%02d.png", "--frames", "2") == ""
    assert [sound(tmp_path / name) for name in ("o.webm", "o.mp4", "o.mkv")] == [[], [], []]


def test_nothing_is_said_of_the_sound_of_a_silent_film(room: Path, tmp_path: Path) -> None:
    write_video(tmp_path / "film.mkv", [numbered(n) for n in range(3)])
    assert play(room, tmp_path / "film.mkv", tmp_path / "o.mkv", "--loop", "--frames", "4") == ""
    assert sound(tmp_path / "o.mkv") == []

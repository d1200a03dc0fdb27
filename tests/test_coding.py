"""Coding of films: FFmpeg's options reach the file, and options that FFmpeg lacks are refused at once."""

from pathlib import Path

import av
import numpy as np
import pytest

from counterlight.command import _progress
from counterlight.errors import InputError
from counterlight.show.output import Coding, open_output


class Picture:
    def __init__(self, codes: np.ndarray) -> None:
        self._codes = codes

    def encoded(self) -> np.ndarray:
        return self._codes

    def linear(self) -> np.ndarray:
        raise AssertionError


def written(path: Path, codes: np.ndarray, coding: Coding) -> tuple[str, str, np.ndarray]:
    """Write a film and return its codec, pixel format and first picture."""
    with open_output(path, 25, coding=coding) as output:
        for number in range(5):
            output.write(Picture(codes), number / 25)
    with av.open(str(path)) as container:
        context = container.streams.video[0].codec_context
        frame = next(container.decode(video=0))
        return context.name, str(context.pix_fmt), frame.to_ndarray(format="rgb24").astype(int)


@pytest.mark.parametrize(
    ("name", "coding", "codec", "pix_fmt"),
    [
        ("a.mp4", Coding(), "h264", "yuv420p"),
        ("a.mp4", Coding(pix_fmt="yuv444p"), "h264", "yuv444p"),
        ("a.mov", Coding("prores_ks", "yuv422p10le"), "prores", "yuv422p10le"),
        ("a.mkv", Coding(), "ffv1", "bgr0"),
        ("a.mkv", Coding("libx264", crf=30), "h264", "yuv420p"),
    ],
)
def test_films_are_coded_as_they_are_asked_for(
    tmp_path: Path, rng: np.random.Generator, name: str, coding: Coding, codec: str, pix_fmt: str
) -> None:
    codes = np.kron(rng.integers(0, 256, (4, 6, 3)), np.ones((8, 8, 1))).astype(np.uint8)
    found = written(tmp_path / name, codes, coding)
    assert found[:2] == (codec, pix_fmt)
    if codec == "ffv1":
        np.testing.assert_array_equal(found[2], codes)


def test_crf_is_obeyed(tmp_path: Path, rng: np.random.Generator) -> None:
    codes = rng.integers(0, 256, (64, 96, 3), np.uint8)
    sizes = []
    for crf in (None, 14, 40):
        path = tmp_path / f"{crf}.mp4"
        written(path, codes, Coding(crf=crf))
        sizes.append(path.stat().st_size)
    assert sizes[0] == sizes[1] > 2 * sizes[2]


@pytest.mark.parametrize(
    ("name", "coding", "message"),
    [
        ("a.png", Coding(crf=3), "--crf: .*a.png is no video"),
        ("a.mp4", Coding("nothing"), "--codec nothing: FFmpeg has no such encoder"),
        ("a.mp4", Coding(pix_fmt="rgb565"), "--pix-fmt rgb565: libx264 takes yuv420p"),
        ("a.mkv", Coding(crf=3), "--crf 3: ffv1 has no loss"),
    ],
)
def test_codings_that_are_not_offered_are_refused(tmp_path: Path, name: str, coding: Coding, message: str) -> None:
    with pytest.raises(InputError, match=message), open_output(tmp_path / name, 25, coding=coding):
        pass
    assert not list(tmp_path.iterdir())


def test_progress_tells_rate_and_time_left() -> None:
    assert _progress(30, 100, 12.0) == "30 of 100, 12 s, 2.5 per second, 28 s left"
    assert _progress(30, None, 12.0) == "30, 12 s"
    assert _progress(0, 100, 12.0) == "0 of 100, 12 s"

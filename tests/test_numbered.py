"""Numbered names: FFmpeg and Counterlight read the files that are written under a pattern."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from counterlight.media.video import MediaReader
from counterlight.writing.numbered import is_numbered, name_of, number_of
from tests.media import copies

NAMES = {
    "%d.png": ("7.png", ["007.png", "-7.png", "٧.png", "7.png.png", ".png"]),
    "a%03d.png": ("a007.png", ["a7.png", "a0007.png", "A007.png"]),
    "a%3d.png": ("a007.png", ["a  7.png", "a7.png"]),
    "100%% %02d%%.png": ("100% 07%.png", ["100%% 07%%.png", "100% 7%.png"]),
    "a+(%d).png": ("a+(7).png", ["aa(7).png", "a7.png"]),
}


@pytest.mark.parametrize("pattern", NAMES)
def test_a_number_has_one_name(pattern: str) -> None:
    name, others = NAMES[pattern]
    assert is_numbered(Path(pattern))
    assert name_of(pattern, 7) == name
    assert number_of(pattern, name) == 7
    assert [number_of(pattern, other) for other in others] == [None] * len(others)
    for number in (0, 9, 10, 123, 12345):
        assert number_of(pattern, name_of(pattern, number)) == number


@pytest.mark.parametrize("name", ["a%%d.png", "a%.png", "a%x.png", "a%123d.png", "a%-3d.png", "ad.png"])
def test_names_without_a_number(name: str) -> None:
    assert not is_numbered(Path(name))
    assert number_of(name, name) is None


@pytest.mark.parametrize("pattern", NAMES)
def test_ffmpeg_opens_the_same_files(pattern: str, tmp_path: Path) -> None:
    folder = tmp_path / "at 50% of %d"  # only the number in the file's name counts
    folder.mkdir()
    for number in range(3):
        (folder / name_of(pattern, 9 + number)).write_bytes(
            cv2.imencode(".png", np.full((4, 5, 3), 50 * number, np.uint8))[1].tobytes()
        )
    with MediaReader.open(folder / pattern) as reader:
        assert [int(planes[0][0, 0]) for _, planes in copies(reader)] == [0, 50, 100]

"""Damage in the middle of a medium: an error when rendering files; a held frame and one line in a show."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from counterlight.errors import InputError
from counterlight.media.video import MediaReader
from tests.media import TIMEOUT_S, damage, number, numbered, until_error, write_h264, write_video

COUNT, KEY = 40, 10  # number of pictures; distance between key frames in pictures


def shown(path: Path, limit: int = 1000, **options: bool) -> tuple[list[tuple[int, int]], list[str]]:
    """Frames of a tolerant reader as (index, number in the picture), and its notices."""
    found: list[tuple[int, int]] = []
    with MediaReader.open(path, tolerant=True, **options) as reader:
        while len(found) < limit and (frame := reader.next_frame(TIMEOUT_S)) is not None:
            found.append((frame.index, number(frame.planes)))
            assert round(frame.time_s * 25) == frame.index  # skipped frames keep their time
            reader.release(frame)
        return found, reader.notices()


@pytest.mark.parametrize("name", ["clip.mp4", "clip.mkv"])
def test_the_frames_around_the_damage_are_shown_and_one_line_says_so(name: str, tmp_path: Path) -> None:
    path = write_h264(tmp_path / name, COUNT)
    damage(path, 2 * KEY, 2 * KEY)
    with MediaReader.open(path) as reader:
        numbers_before, error = until_error(reader)
    assert len(numbers_before) < COUNT
    assert re.search(rf"{name}: frame .* cannot be decoded", error)
    found, notices = shown(path)
    numbers = dict(found)
    lost = set(range(COUNT)) - numbers.keys()
    assert 2 * KEY in lost
    # all frames up to the next key frame, and two frames that depend on the lost frame
    assert lost <= set(range(2 * KEY - 2, 3 * KEY))
    assert all(numbers[index] == index % 25 for index in numbers if index < 2 * KEY - 2 or index >= 3 * KEY)
    (notice,) = notices
    assert f"{path}: frame" in notice
    assert notice.endswith("; left out, as all that cannot be decoded")


def test_a_loop_goes_round_and_tells_of_it_once(tmp_path: Path) -> None:
    path = write_h264(tmp_path / "clip.mkv", COUNT)
    damage(path, 2 * KEY, 2 * KEY)
    found, notices = shown(path, 3 * COUNT, loop=True)
    assert found[-1][0] > 2 * COUNT
    assert len(notices) == 1


def test_a_truncated_video_ends_where_it_ends(tmp_path: Path) -> None:
    path = write_h264(tmp_path / "clip.mp4", COUNT, container_options={"movflags": "faststart"})
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 6 // 10])
    found, notices = shown(path)
    assert [number for _, number in found] == [n % 25 for n in range(len(found))]
    assert KEY < len(found) < COUNT
    assert len(notices) == 1


def test_a_damaged_picture_of_a_sequence_is_left_out(tmp_path: Path) -> None:
    for index in range(6):
        cv2.imwrite(str(tmp_path / f"{index:02}.png"), np.full((34, 46), 10 * index, np.uint8))
    spoilt = tmp_path / "03.png"
    spoilt.write_bytes(spoilt.read_bytes()[:60])
    with MediaReader.open(tmp_path / "%02d.png", tolerant=True) as reader:
        codes = []
        while (frame := reader.next_frame(TIMEOUT_S)) is not None:
            codes.append(int(frame.planes[0][0, 0]))
            reader.release(frame)
        assert codes == [0, 10, 20, 40, 50]
        assert len(reader.notices()) == 1


@pytest.mark.parametrize("loop", [False, True])
def test_a_medium_without_a_good_picture_is_an_error(tmp_path: Path, loop: bool) -> None:
    pictures = [numbered(n) for n in range(10)]
    path = write_video(tmp_path / "clip.mkv", pictures, codec="mpeg4", options={"g": "1"})
    damage(path, 0, 9)
    with pytest.raises(InputError, match="its data is damaged; it is damaged"):
        shown(path, 10 * COUNT, loop=loop)

"""Films decoded by a GPU, or by the processor without a GPU: the same pictures, with one line of explanation."""

import os
import signal
from pathlib import Path

import numpy as np
import pytest

from counterlight.media.decoding.devices import TYPES
from counterlight.media.video import MediaReader
from counterlight.tools.shipped import CLIP
from tests.programs import fail

FRAMES = 8


def pictures(medium: Path, hwdec: str) -> tuple[list[np.ndarray], list[float], list[str]]:
    """Y, Cb and Cr of the first frames and of a frame after a seek, their times, and the notices."""
    shown, times = [], []
    with MediaReader.open(medium, hwdec=hwdec) as reader:
        for number in range(FRAMES + 1):
            if number == FRAMES:
                reader.seek(3.0)
            frame = reader.next_frame(timeout_s=30)
            assert frame is not None
            shown += [plane.copy() for plane in frame.planes]
            times.append(frame.time_s)
            reader.release(frame)
        return shown, times, reader.notices()


@pytest.fixture(scope="module")
def by_the_processor() -> tuple[list[np.ndarray], list[float], list[str]]:
    return pictures(CLIP, "no")


@pytest.mark.parametrize("hwdec", ["auto", *TYPES])
def test_whatever_decodes_the_pictures_are_the_same(
    hwdec: str, by_the_processor: tuple[list[np.ndarray], list[float], list[str]]
) -> None:
    """Every device decodes H.264 to the same codes. A notice names a device that is not available."""
    shown, times, said = pictures(CLIP, hwdec)
    assert times == by_the_processor[1]
    for found, expected in zip(shown, by_the_processor[0], strict=True):
        np.testing.assert_array_equal(found, expected)
    assert len(said) <= 1
    for line in said:
        assert f"--hwdec {hwdec} does not decode it (" in line
        assert line.endswith("; the processor does")


def test_a_device_that_is_not_there_is_said() -> None:
    _, _, said = pictures(CLIP, "cuda:99")
    assert said == [line for line in said if "--hwdec cuda:99 does not decode it" in line]
    assert len(said) == 1


def test_a_decoder_that_a_driver_has_killed_is_replaced_by_one_that_needs_none() -> None:
    with MediaReader.begin(CLIP, hwdec="cuda") as reader:
        os.kill(reader.decoder_pid, signal.SIGKILL)
        while not reader.ready(0.1):
            pass
        frame = reader.next_frame(timeout_s=30)
        assert frame is not None
        assert frame.time_s == 0
        reader.release(frame)
        (line,) = reader.notices()
        assert "decoder" in line
        assert "restarted" in line


def test_a_kind_that_nobody_knows_is_refused() -> None:
    assert "expected no, auto or one of cuda, vaapi" in fail("play", "room", CLIP, "--hwdec", "3dfx")

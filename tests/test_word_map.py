"""T packed in words, stored next to the other maps: read as it was built, only on request, and refused if damaged."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from counterlight import calibration
from counterlight.errors import InputError
from counterlight.files import exr
from counterlight.maps.room_maps import FOLDER, read_maps
from counterlight.maps.small_map import THREE
from counterlight.tools.inverse.build import BuiltRoom, build_room_maps
from counterlight.tools.inverse.near_light import InverseOptions
from tests.mutants import DamagedRoom
from tests.rooms import write_blurred_room

CHANNELS = {"words": ("WORD",), "rows": ("START", "COLOUR")}


@pytest.fixture
def built(tmp_path: Path) -> BuiltRoom:
    write_blurred_room(tmp_path / "room", np.random.default_rng(3), (9, 14), (6, 8))
    return build_room_maps(calibration.read(tmp_path / "room"), InverseOptions(0.1))


@pytest.fixture
def room(tmp_path: Path, built: BuiltRoom) -> DamagedRoom:
    return DamagedRoom.of(tmp_path / "room")


def test_words_are_stored_as_they_were_built(built: BuiltRoom, room: DamagedRoom) -> None:
    stored = calibration.read(room.folder)
    words, made = read_maps(stored, words=True).words, built.maps.words
    assert words is not None
    assert made is not None
    assert words.used == made.used
    assert (
        words.maps.keys() == made.maps.keys() == built.maps.named().keys() - {".", "direct", "undo_gather", "undo_mix"}
    )
    for name, each in words.maps.items():
        np.testing.assert_array_equal(each.rows, made.maps[name].rows)
        np.testing.assert_array_equal(each.words, made.maps[name].words)
        assert (each.source_shape, each.scale) == (made.maps[name].source_shape, made.maps[name].scale)
    assert read_maps(stored).words is None
    assert read_maps(stored, refinement=False, words=True).words is None


def test_maps_of_before_have_none(room: DamagedRoom) -> None:
    name = f"{FOLDER}/manifest.toml"
    text = room.files[name].decode()
    room.put(name, text.replace("[words", "[older").encode())
    assert read_maps(calibration.read(room.folder), words=True).words is None


def outside(words: np.ndarray) -> None:
    """Make the first word jump over as many source pixels as a word can state."""
    words[0] |= 0x1FFF << 3


def torn(words: np.ndarray) -> None:
    """Let the last word begin an entry of three codes without a following word."""
    words[-1] = THREE


@pytest.mark.parametrize(
    ("part", "change", "complaint"),
    [
        ("words", outside, "a word lies outside the 48 source pixels"),
        ("words", torn, "a word lies outside the 48 source pixels"),
        ("rows", lambda starts: np.put(starts, 0, 1), "a row points outside its words"),
        ("rows", lambda starts: np.put(starts, -1, 1 << 31), "a row points outside its words"),
        ("rows", lambda starts: np.put(starts, [3, 4], [9, 0]), "a row points outside its words"),
    ],
)
def test_words_that_would_be_read_elsewhere_are_refused(
    room: DamagedRoom, part: str, change: Callable[[np.ndarray], None], complaint: str
) -> None:
    """The checksums are renewed after the damage."""
    path = room.folder / FOLDER / "words" / "transport" / f"{part}.exr"
    channels = exr.read_channels(path)
    used = int(exr.read_channels(path.with_name("rows.exr"))["START"].max())
    values = channels[CHANNELS[part][0]].ravel()
    change(values[:used] if part == "words" else values)
    channels[CHANNELS[part][0]] = values.reshape(channels[CHANNELS[part][0]].shape)
    exr.write_channels(path, channels)
    room.put(str(path.relative_to(room.folder)), path.read_bytes())
    with pytest.raises(InputError, match=complaint):
        room.read()
    read_maps(calibration.read(room.folder))  # a reader that does not request words does not see the damage


def test_damaged_words_are_refused_by_their_checksum(room: DamagedRoom) -> None:
    name = f"{FOLDER}/words/dual/words.exr"
    room.put(name, room.files[name][:-1] + b"\xff", renewed=False)
    with pytest.raises(InputError, match=r"dual/words\.exr"):
        room.read()

"""A damaged medium: in a window the show continues, and a written file must be complete."""

import json
from pathlib import Path

from tests.media import damage, write_h264
from tests.programs import command, fail, on

COUNT, KEY = 40, 10  # number of pictures; distance between key frames in pictures


def test_a_show_goes_on_where_a_file_is_refused(xvfb: str, plain_room: Path, tmp_path: Path) -> None:
    clip, stats = write_h264(tmp_path / "clip.mkv", COUNT), tmp_path / "stats.json"
    damage(clip, 2 * KEY, 2 * KEY)
    options = "--no-config", "--no-audio", "--stats", stats
    done = command("play", plain_room, clip, *options, **on(xvfb))
    assert done.returncode == 0, done.stderr
    numbers = json.loads(stats.read_text())
    (notice,) = numbers["notices"]
    assert "clip.mkv: frame" in notice
    assert notice in done.stderr
    assert numbers["dropped"] >= 1
    assert numbers["frames"] + numbers["dropped"] == COUNT
    assert "cannot be decoded" in fail("play", plain_room, clip, "--output", tmp_path / "out.mkv")
    assert not (tmp_path / "out.mkv").exists()

"""A damaged medium in a window, where the show goes on, and in a file, which must be whole."""

import json
from pathlib import Path

from tests.gl.test_reload import room  # noqa: F401 (a fixture)
from tests.test_damaged_video import COUNT, KEY, damage
from tests.test_player import command, fail
from tests.test_video import _h264


def test_a_show_goes_on_where_a_file_is_refused(xvfb: str, room: Path, tmp_path: Path) -> None:  # noqa: F811
    clip, stats = _h264(tmp_path / "clip.mkv", COUNT), tmp_path / "stats.json"
    damage(clip, 2 * KEY, 2 * KEY)
    options = "--no-config", "--no-audio", "--stats", stats
    done = command("play-corrected", room, clip, *options, DISPLAY=xvfb, WAYLAND_DISPLAY="")
    assert done.returncode == 0, done.stderr
    numbers = json.loads(stats.read_text())
    (notice,) = numbers["notices"]
    assert "clip.mkv: frame" in notice
    assert notice in done.stderr
    assert numbers["dropped"] >= 1
    assert numbers["frames"] + numbers["dropped"] == COUNT
    assert "cannot be decoded" in fail("play-corrected", room, clip, "--output", tmp_path / "out.mkv")
    assert not (tmp_path / "out.mkv").exists()

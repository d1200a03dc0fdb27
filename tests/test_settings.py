"""Settings, options and playlists: names, values, files, error messages."""

from pathlib import Path

import numpy as np
import pytest

from counterlight.errors import InputError
from counterlight.media.frames import MediaInfo, radiance_frame
from counterlight.media.medium import Border, Medium
from counterlight.pipeline.adjustments import Adjustments
from counterlight.pipeline.value_types import Choice, Flag, Number
from counterlight.show.command_line import _default_path, read_options
from counterlight.show.from_options import adjustments_of, image_display_duration, monitors_of
from counterlight.show.into_file import ignored
from counterlight.show.keys import KEYS
from counterlight.show.options import OPTIONS, Option
from counterlight.show.playlist import Playlist, expand


@pytest.fixture
def config(tmp_path: Path) -> Path:
    return tmp_path / "player.toml"


def options_with(config: Path, text: str, *arguments: str):  # type: ignore[no-untyped-def]
    config.write_text(text)
    return read_options(["room", "clip.mp4", "--config", str(config), *arguments], "")


def test_settings_are_defaults_that_options_override(config: Path) -> None:
    text = """
refine = 7
compensation = false
loop = true
view = "camera"
white = 0.5
image-display-duration = "inf"
black-level = 0.1
brightness = -5
monitor = "HDMI-1"
[keys]
"ctrl+x" = "quit"
"""
    options = options_with(config, text)
    assert (options.refine, options.compensation, options.loop, options.view) == (7, False, True, "camera")
    assert (options.white, options.monitor) == (0.5, "HDMI-1")
    assert adjustments_of(options) == Adjustments(brightness=-5, black_level=0.1)
    assert options.keys == {"ctrl+x": "quit"}
    assert image_display_duration(options) is None
    options = options_with(config, text, "--refine", "auto", "--compensation", "--no-loop", "--brightness", "3")
    assert (options.refine, options.compensation, options.loop, options.brightness) == ("auto", True, False, 3)


def test_a_setting_names_the_monitors_of_several_projectors(config: Path) -> None:
    assert monitors_of(options_with(config, 'monitor = ["HDMI-1", 2]')) == ["HDMI-1", "2"]
    assert monitors_of(options_with(config, 'monitor = ["HDMI-1", 2]', "--monitor", "A", "--monitor", "B")) == [
        "A",
        "B",
    ]
    assert monitors_of(options_with(config, "monitor = 1")) == ["1"]
    assert monitors_of(options_with(config, "monitor = []")) == []


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("refin = 3", "no setting 'refin'; did you mean 'refine'?"),
        ("no-vsync = true", "no setting 'no-vsync'; did you mean 'vsync'?"),
        ("output = 'x.png'", "no setting 'output'"),
        ("refine = -1", "refine: expected auto or a number of steps"),
        ("refine = [1]", "refine: expected text or a number, found [1]"),
        ("monitor = [['A']]", "monitor: expected text or a number, found ['A']"),
        ("refine = true", "refine: expected text or a number, found True"),
        ("loop = 'yes'", "loop: expected true or false, found 'yes'"),
        ("view = 'side'", "view: expected projector, camera"),
        ("brightness = 200", "brightness: expected a whole number from -100 to 100"),
        ("flicker = 0.99", "flicker: expected a number from 0 to 0.95"),
        ("keys = 3", "[keys]"),
        ('monitor = "a\\u0000b"', "monitor: expected text or a number, found 'a\\x00b'"),
        ('monitor = """a\nb"""', "monitor: expected text or a number, found 'a\\nb'"),
        (f"monitor = '{'x' * 2000}'", "monitor: expected text or a number, found 'xxx"),
        (f"start = {10**30}", "an integer of more than 64 bits"),
        (f"{'x' * 2000} = 1", "no setting 'xxx"),
        ("[keys]\na = 3", "key 'a': expected a command as text, found 3"),
        ("= 3", "not valid TOML"),
    ],
)
def test_a_wrong_setting_is_one_line_that_names_the_file(config: Path, text: str, complaint: str) -> None:
    with pytest.raises(InputError) as caught:
        options_with(config, text)
    line = str(caught.value)
    assert complaint in line
    assert line.startswith(str(config))
    assert "\n" not in line


@pytest.mark.parametrize(("name", "row"), OPTIONS.items())
def test_a_row_of_the_table_is_an_option_and_a_setting(config: Path, name: str, row: Option) -> None:
    kind, attribute = row.kind, name.replace("-", "_")
    if not row.setting:
        with pytest.raises(InputError, match=f"no setting '{name}'"):
            options_with(config, f"{name} = true")
        return
    if isinstance(kind, Flag):
        words, value, text = [f"--{'no-' if row.default else ''}{name}"], not row.default, str(not row.default).lower()
    elif isinstance(kind, Number | Choice):
        value = kind.low if isinstance(kind, Number) else next(word for word in kind.words if word != row.default)
        words, text = [f"--{name}={value}"], f"'{value}'"
    else:
        return  # paths, addresses and names have tests of their own
    assert getattr(options_with(config, f"{name} = {text}"), attribute) == value
    options = options_with(config, "", *words)
    assert getattr(options, attribute) == value
    assert options.given == ({"config"} if value == row.default else {"config", name})


def test_no_key_is_bound_twice() -> None:
    keys = [key for row in OPTIONS.values() for key in row.keys]
    assert len(keys) == len(set(keys))
    assert all(KEYS[key] == command for row in OPTIONS.values() for key, (command, _) in row.keys.items())


def test_a_file_ignores_what_is_for_a_window() -> None:
    options = read_options(["room", "a.mp4", "--no-config", "--output", "b.mp4", "--fullscreen", "--speed", "2"], "")
    pixels = radiance_frame(np.zeros((2, 3, 3), np.float32)).format
    lines = ignored(options, MediaInfo("a.mp4", pixels, 25.0, 1.0, False, "h264", 25))
    assert lines == [f"--{name}: is for a window, has no effect with --output" for name in ("speed", "fullscreen")]


def test_where_settings_are_looked_for(config: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert _default_path({"XDG_CONFIG_HOME": "/x"}, Path("/home/a")) == Path("/x/counterlight/player.toml")
    assert _default_path({}, Path("/home/a")) == Path("/home/a/.config/counterlight/player.toml")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    assert read_options(["room", "a"], "").refine is None  # a missing settings file causes no complaint
    (tmp_path / "counterlight").mkdir()
    (tmp_path / "counterlight" / "player.toml").write_text("refine = 3")
    assert read_options(["room", "a"], "").refine == 3
    assert read_options(["room", "a", "--no-config"], "").refine is None
    with pytest.raises(InputError, match="missing"):
        read_options(["room", "a", "--config", str(config)], "")


def test_options_may_stand_between_calibration_and_media() -> None:
    options = read_options(["room", "--no-config", "--loop", "a.png", "--view", "camera", "b.png"], "")
    assert (options.calibration, options.media) == (Path("room"), [Medium("a.png"), Medium("b.png")])
    assert image_display_duration(options) == 5
    options.image_display_duration = "inf"
    assert image_display_duration(options) is None


def media(*names: Path | str) -> list[Medium]:
    return [Medium(str(name)) for name in names]


def test_lists_name_media_beside_them(tmp_path: Path) -> None:
    plain, m3u = tmp_path / "a.txt", tmp_path / "b.m3u"
    plain.write_text("# a comment\n\none.png\n/two.mp4\n")
    m3u.write_text("\ufeff#EXTM3U\n#EXTINF:3,Three\nthree.png\nhttp://x/four\n", encoding="utf-8")
    expected = [str(tmp_path / "one.png"), "/two.mp4", "zero.png", str(tmp_path / "three.png"), "http://x/four"]
    films = [str(tmp_path / f"film{number}.mkv") for number in (1, 2, 10)]
    for name in (*films, tmp_path / ".film3.mkv", tmp_path / "notes.pdf"):
        Path(name).touch()
    found = expand(media(plain, "zero.png", m3u, tmp_path), Border())
    assert [medium.name for medium in found] == [*expected, *films]


@pytest.mark.parametrize(
    ("contents", "complaint"),
    [(b"", "lists no medium"), (b"\xff\xfe", "no UTF-8 text"), (b"other.m3u", "lists the list other.m3u")],
)
def test_a_list_that_cannot_be_used(tmp_path: Path, contents: bytes, complaint: str) -> None:
    path = tmp_path / "list.m3u"
    path.write_bytes(contents)
    with pytest.raises(InputError, match=complaint):
        expand(media(path), Border())
    with pytest.raises(InputError, match="no such file"):
        expand(media(tmp_path / "none.txt"), Border())
    with pytest.raises(InputError, match=f"{tmp_path}: a folder without films and pictures"):
        expand(media(tmp_path), Border())
    assert expand(media(path, "a.png"), Border(), patient=True) == media(path, "a.png")


def test_a_list_goes_on_back_and_round() -> None:
    playlist = Playlist(["a", "b"])
    assert not playlist.step(-1)
    assert playlist.step(1)
    assert not playlist.step(1)
    assert playlist.current.name == "b"
    assert Playlist(["a", "b"], start=1).current.name == "b"
    playlist.loop = True
    assert playlist.step(1)
    assert playlist.current.name == "a"
    playlist.add(media("c"), replace=False)
    assert playlist.step(-1)
    assert playlist.current.name == "c"
    playlist.unfold(media("x", "y"))
    assert (playlist.media, playlist.current.name) == (media("a", "b", "x", "y"), "x")
    playlist.add(media("d"), replace=True)
    assert (playlist.media, playlist.current.name) == (media("d"), "d")

"""Files from outside: irregular files, TOML that costs too much, values of wrong types or ranges."""

import hashlib
import os
import socket
from collections.abc import Callable
from pathlib import Path

import pytest
import tomli_w

from counterlight.errors import InputError
from counterlight.files.reading import MAX_TOML_BYTES, MOST_PARTS, DescribedFiles, read_bytes, read_toml
from counterlight.files.tables import Table
from counterlight.response import read_response
from counterlight.tools.simulation.scene import load_scene
from tests.hostile import little_memory, without_rights

FIX = "make it again"


def a_socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(path))


NO_FILES: dict[str, tuple[Callable[[Path], object], str]] = {
    "absent": (lambda path: None, "missing; make it again"),
    "a folder": (Path.mkdir, "a folder, expected a regular file; make it again"),
    "a pipe": (os.mkfifo, "a pipe, expected a regular file; make it again"),
    "a device": (lambda path: path.symlink_to("/dev/zero"), "a device, expected a regular file; make it again"),
    "a socket": (a_socket, "cannot be read .*; check the path"),
    "a loop": (lambda path: path.symlink_to(path), "cannot be read .*; check the path"),
    "below a file": (lambda path: path.parent.write_text(""), "missing; make it again"),
    "endless": (lambda path: path.symlink_to("/proc/self/mem"), "cannot be read .*; check the path"),
}


@pytest.mark.parametrize("kind", NO_FILES)
def test_what_is_no_file_is_refused_at_once(tmp_path: Path, kind: str) -> None:
    make, complaint = NO_FILES[kind]
    path = tmp_path / ("file/below" if kind == "below a file" else "calibration.toml")
    make(path)
    with pytest.raises(InputError, match=complaint), little_memory():
        read_toml(path, FIX)


def test_a_file_that_may_not_be_read_is_not_to_be_made_again(tmp_path: Path) -> None:
    path = tmp_path / "secret.toml"
    path.write_text("format = 1")
    path.chmod(0)
    with (
        without_rights(),
        pytest.raises(InputError, match=r"secret\.toml: permission denied; give this user") as caught,
    ):
        read_toml(path, FIX)
    assert FIX not in str(caught.value)


def test_no_more_is_read_than_was_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"x" * 1000)
    assert read_bytes(path, 1000, FIX) == b"x" * 1000
    with pytest.raises(InputError, match="more than the 999 bytes"):
        read_bytes(path, 999, FIX)
    os.truncate(path, 1 << 40)  # a sparse file
    with pytest.raises(InputError, match="more than the 1048576 bytes"), little_memory():
        read_toml(path, FIX)
    status = read_bytes(Path("/proc/self/status"), 1 << 20, FIX)  # reports a size of 0 bytes
    assert status.startswith(b"Name:")
    with pytest.raises(InputError, match="more than the 10 bytes"):
        read_bytes(Path("/proc/self/status"), 10, FIX)


def test_what_was_checked_is_what_is_read(tmp_path: Path) -> None:
    """A file that replaces the checked file is not read."""
    path = tmp_path / "data"
    path.write_bytes(b"right")
    described = {"data": {"bytes": 5, "sha256": hashlib.sha256(b"right").hexdigest()}}
    with DescribedFiles(tmp_path, described, FIX).opened(path) as file:
        (tmp_path / "other").write_bytes(b"wrong")
        (tmp_path / "other").replace(path)
        assert file.read() == b"right"
    with (
        pytest.raises(InputError, match="its SHA-256 differs"),
        DescribedFiles(tmp_path, described, FIX).opened(path),
    ):
        pass
    with (
        pytest.raises(InputError, match="does not list other"),
        DescribedFiles(tmp_path, described, FIX).opened(tmp_path / "other"),
    ):
        pass


COSTLY = {
    "nested arrays": ("a = " + "[" * 1000 + "]" * 1000, "nested too deeply"),
    "nested tables": ("a = " + "{a = " * 1000 + "1" + "}" * 1000, "nested too deeply"),
    "dotted key": ("a." * 100_000 + "a = 1", f"a dotted key of more than {MOST_PARTS} parts"),
    "quoted dotted key": ('"\\"" . \'b\'.' * 50_000 + "a = 1", f"a dotted key of more than {MOST_PARTS} parts"),
    "dotted header": ("[" + ".".join("ab" * 500) + "]\n" + "".join(f"k{i} = 1\n" for i in range(90_000)), "dotted key"),
    "after a string": ('a = """\\"""" # "\n' + "b." * 100 + "b = 1", "a dotted key of more"),
    "digits": ("a = " + "9" * 5000, "an integer of more than 64 bits"),
    "hexadecimal digits": ("a = 0x" + "f" * 5000, "an integer of more than 64 bits"),
    "2⁶³": (f"a = [[{{b = {1 << 63}}}]]", "an integer of more than 64 bits"),
    "not UTF-8": ("a = '\udcff'", "not valid TOML"),
    "too long": ("#" * (MAX_TOML_BYTES + 1), "more than the 1048576 bytes"),
    "a long name twice": (f"{'n' * 5000} = 1\n" * 2, "not valid TOML .{,300}$"),
}


@pytest.mark.parametrize("kind", COSTLY)
def test_toml_that_costs_too_much_is_refused(tmp_path: Path, kind: str) -> None:
    """Each text would take gigabytes, half a minute, or Python's stack (headers of 1000 parts, 90 000 lines: 13 s)."""
    text, complaint = COSTLY[kind]
    path = tmp_path / "file.toml"
    path.write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(InputError, match=rf"file\.toml: .*{complaint}"), little_memory():
        read_toml(path, FIX)


@pytest.mark.parametrize(
    "text",
    [
        "a = 1.5 # e.g. a . b",
        'a = "' + "1." * 100 + '"',  # inside a string, dots are text
        "a = '''\n" + "b." * 100 + '\'\'\'\nc = """d\\""""',
        ".".join("a" * MOST_PARTS) + " = 1",
        "a = [" + "0.25, " * 100 + "]",
        f"a = [{-(1 << 63)}, {(1 << 63) - 1}, -0.0, inf]",
    ],
)
def test_toml_of_every_day_is_read(tmp_path: Path, text: str) -> None:
    path = tmp_path / "file.toml"
    path.write_text(text)
    assert "a" in read_toml(path, FIX)


def test_what_commands_write_fits(tmp_path: Path) -> None:
    """The longest file describes eight projectors, each with a measured response of 256 rows."""
    rows = [[i / 255 * (1 - 1e-9 * c) for c in range(3)] for i in range(256)]
    text = tomli_w.dumps({"projectors": [{"width": 1920, "height": 1080, "response": rows}] * 8})
    assert len(text) < MAX_TOML_BYTES / 4
    (tmp_path / "calibration.toml").write_text(text)
    assert len(read_toml(tmp_path / "calibration.toml", FIX)["projectors"]) == 8


VALUES = {
    "yes": True,
    "one": 1,
    "half": 0.5,
    "far": 1e400,
    "no": float("nan"),
    "long": "x" * 2000,
    "name": "a",
    "big": 2**62,
}
VALUES |= {
    "up": "../x",
    "root": "/etc/passwd",
    "nul": "a\0b",
    "below": "a/b.png",
    "rows": [[0, 1]] * 5000,
    "size": [3, 2],
}


@pytest.mark.parametrize(
    ("ask", "complaint"),
    [
        (lambda t: t.number("yes", None, 0, 1), "yes: found True, expected a number from 0 to 1; make it again"),
        (lambda t: t.number("far", None, 0, 1), "far: found inf, expected a number"),
        (lambda t: t.number("no", None, -1e300, 1e300), "no: found nan, expected a number"),
        (lambda t: t.integer("yes", None, 0, 1), "yes: found True, expected a whole number from 0 to 1"),
        (lambda t: t.integer("half", None, 0, 1), "half: found 0.5, expected a whole number"),
        (lambda t: t.text("long"), r"long: found 'x{79}…, expected a text of at most 1000 characters"),
        (lambda t: t.text("one"), "one: found 1, expected a text"),
        (lambda t: t.truth("one", False), "one: found 1, expected true or false"),
        (lambda t: t.path("up", Path("room")), r"up: found '\.\./x', expected a path relative to room, without '\.\.'"),
        (lambda t: t.path("root", Path("room")), "root: found '/etc/passwd', expected a path relative"),
        (lambda t: t.path("nul", Path("room")), r"nul: found 'a\\x00b', expected a path relative"),
        (lambda t: t.rows("rows", None, 2, 0, 1), "rows: found .{81}, expected a list of 2 to 4096 lists of 2 numbers"),
        (lambda t: t.size("rows", 100), "rows: found .*, expected .width, height."),
        (lambda t: t.size("size", 5), "size: found .3, 2., expected .width, height. of at most 5 pixels"),
        (lambda t: t.tables("rows"), r"needs one to 1000 \[\[rows\]\]"),
        (lambda t: t.table("one"), r"needs a table \[one\]"),
        (lambda t: t.format(1), "format None, this version reads 1; make it again"),
        (lambda t: t.number("white", None, 0, 1), "needs white"),
        (lambda t: t.number("nam", None, 0, 1), "needs nam; is 'name' meant to be it"),
        (read_response, None),
    ],
)
def test_a_value_that_is_not_what_it_should_be(ask: Callable[[Table], object], complaint: str | None) -> None:
    table = Table(VALUES, "room.toml", FIX)
    if complaint is None:
        ask(table)
        return
    with pytest.raises(InputError, match=rf"^room\.toml[,:] .*{complaint}"):
        ask(table)


def test_values_that_are_what_they_should_be() -> None:
    table = Table(VALUES, "room.toml")
    assert table.number("one", None, 0, 1) == 1
    assert table.integer("big", None, 0, 1 << 63) == 1 << 62
    assert table.size("size", 6) == (2, 3)
    assert table.path("below", Path("room")) == Path("room/a/b.png")


@pytest.mark.parametrize("name", ["../x.png", "/x.png"])
@pytest.mark.parametrize("key", ["texture", "heights", "file"])
def test_a_scene_names_files_beside_it(tmp_path: Path, key: str, name: str) -> None:
    shape = {
        "texture": "edge_u = [1, 0, 0]\nedge_v = [0, 1, 0]\ncorner = [0, 0, 0]",
        "heights": 'shape = "relief"\nedge_u = [1, 0, 0]\nedge_v = [0, 1, 0]\ncorner = [0, 0, 0]\nheight = 1',
        "file": 'shape = "mesh"',
    }
    device = "width = 9\nheight = 9\nposition = [0, 0, 2]\nlook_at = [0, 0, 0]\nhorizontal_field_of_view_deg = 30\n"
    text = f"[projector]\n{device}[camera]\n{device}[[surfaces]]\n{shape[key]}\n{key} = '{name}'\n"
    (tmp_path / "scene.toml").write_text(text)
    with pytest.raises(
        InputError, match=rf"surfaces 1, {key}: found '{name}', expected a path relative to .*, without"
    ):
        load_scene(tmp_path / "scene.toml")
    (tmp_path / "scene.toml").write_text(f"[projector]\n{device}response = '{name[:-3]}toml'\n[camera]\n{device}")
    with pytest.raises(InputError, match=r"\[projector\], response: found .*, expected a path relative to .*, without"):
        load_scene(tmp_path / "scene.toml")

"""ctrl+r with edited shaders of an installed copy, in a window and over the control socket."""

import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from counterlight.passes.shown_maps import Split
from tests.desktop import expected_picture, screen
from tests.programs import PATIENCE_S, ROOT, on, running, wait_until
from tests.remote import Client

BOX = (0, 0, 100, 75)


@pytest.fixture
def installed(tmp_path: Path) -> Path:
    """Return a folder with the package as a wheel installs it."""
    folder = tmp_path / "installed"
    left_out = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / "player", folder / "counterlight", ignore=left_out)
    shutil.copytree(ROOT / "shaders", folder / "counterlight" / "shaders", ignore=left_out)
    return folder


@pytest.fixture
def playing_copy(xvfb: str, installed: Path, plain_room: Path, noise_picture: Path) -> Iterator[subprocess.Popen[str]]:
    """Run the copy's player in a window, with the control socket `show.socket` next to it."""
    options = "--no-config", "--osd", "off", "--shader", "fragment", "--control", installed / "show.socket"
    program = sys.executable, "-P", "-m", "counterlight.app"
    with running(*program, plain_room, noise_picture, *options, **on(xvfb), PYTHONPATH=str(installed)) as process:
        yield process


@pytest.fixture
def corrected(plain_room: Path, noise_picture: Path, tmp_path: Path) -> np.ndarray:
    """Return what the projector shows with the unedited shaders."""
    return expected_picture(plain_room, noise_picture, tmp_path)


@pytest.fixture
def client(xvfb: str, installed: Path, corrected: np.ndarray, playing_copy: subprocess.Popen[str]) -> Iterator[Client]:
    """Connect to the copy's player as soon as it shows its picture."""
    wait_until(lambda: np.array_equal(screen(xvfb, BOX), corrected), "the picture", playing_copy)
    with Client(installed / "show.socket") as client:
        yield client


def assert_shown_again(client: Client, display: str, corrected: np.ndarray, player: subprocess.Popen[str]) -> None:
    """Wait until the picture without compensation has changed, and the compensated picture is correct."""
    for compensation in (False, True):
        assert client.ask("set_property", "compensation", compensation)["error"] == "success"
        wait_until(lambda c=compensation: np.array_equal(screen(display, BOX), corrected) == c, "the picture", player)


def test_shaders_are_compiled_anew_and_damaged_ones_leave_the_old(
    xvfb: str, installed: Path, corrected: np.ndarray, playing_copy: subprocess.Popen[str], client: Client
) -> None:
    shaders = installed / "counterlight" / "shaders"
    present, encode = ((shaders / name).read_text() for name in ("present.frag", "encode.frag"))
    result = "encoded = vec4(code, 1.0)"
    assert result in present

    def shows(wanted: np.ndarray) -> None:
        wait_until(lambda: np.array_equal(screen(xvfb, BOX), wanted), "the picture", playing_copy)

    steps: list[tuple[str, str, str, np.ndarray]] = [
        ("present.frag", present.replace(result, "encoded = vec4(1.0 - code, 1.0)"), "", 255 - corrected),
        ("present.frag", present.replace(result, "encoded = vec4(codes, 1.0)"), "present.frag", 255 - corrected),
        ("present.frag", present.replace("place.zw", "ivec2(9)").replace("place.xy", "0"), "place", 255 - corrected),
        ("present.frag", present, "", corrected),
        ("encode.frag", "#version 330 core\nvoid main() { nothing }", "encode.frag", corrected),
        ("encode.frag", encode, "", corrected),
    ]
    for name, text, complaint, wanted in steps:
        (shaders / name).write_text(text)
        answer = client.ask("reload")
        if complaint:
            assert answer["error"] == "error running command"
            assert "not reloaded" in answer["message"]
            assert complaint in answer["message"]
        else:
            assert answer["error"] == "success", answer
        for compensation in (False, True):  # both frames are drawn with the new shaders
            assert client.ask("set_property", "compensation", compensation)["error"] == "success"
        shows(wanted)
    playing_copy.terminate()
    playing_copy.communicate(timeout=PATIENCE_S)


def test_a_shader_that_fails_only_when_it_draws_leaves_the_old(
    xvfb: str, installed: Path, corrected: np.ndarray, playing_copy: subprocess.Popen[str], client: Client
) -> None:
    """encode.frag without its textures compiles and links. The pass fails when it draws the first picture."""
    shader = installed / "counterlight" / "shaders" / "encode.frag"
    text = shader.read_text()
    head, _, _ = text.partition("void main")
    shader.write_text(head + "void main() { encoded = vec4(scale * highest); }")
    assert client.ask("reload")["error"] == "success"
    wait_until(lambda: "not reloaded" in " ".join(client.get("notices")), "what is wrong", playing_copy)
    assert_shown_again(client, xvfb, corrected, playing_copy)


def test_a_shader_that_only_another_view_draws_does_not_end_the_show(
    xvfb: str, installed: Path, corrected: np.ndarray, playing_copy: subprocess.Popen[str], client: Client
) -> None:
    (installed / "counterlight" / "shaders" / Split.shader).write_text("#version 330 core\nvoid main() { nothing }")
    assert client.ask("reload")["error"] == "success"
    assert client.ask("set_property", "view", "split")["error"] == "success"
    wrong = f"not drawn: shaders/{Split.shader}"
    wait_until(lambda: wrong in " ".join(client.get("notices")), "what is wrong", playing_copy)
    assert client.ask("set_property", "view", "projector")["error"] == "success"
    assert_shown_again(client, xvfb, corrected, playing_copy)

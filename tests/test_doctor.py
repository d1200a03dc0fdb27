"""counterlight doctor as a user runs it, and the command lines that install system packages."""

import json
import os
import sys
from pathlib import Path

import pytest

from counterlight.command import BAD_INPUT, DONE
from counterlight.gl.context import PACKAGES
from counterlight.tools import check_machine, system_packages
from counterlight.tools.system_packages import Part
from tests.programs import command

NO_SCREEN = {"DISPLAY": "", "WAYLAND_DISPLAY": ""}


def test_a_machine_without_a_screen_is_ready_to_render_headless() -> None:
    outcome = command("doctor", **NO_SCREEN)
    assert outcome.returncode == DONE, outcome.stdout
    assert outcome.stderr == ""
    assert "ready: the player can run here" in outcome.stdout
    assert "note    window system: neither DISPLAY nor WAYLAND_DISPLAY is set" in outcome.stdout
    assert "xvfb-run" in outcome.stdout


def test_every_part_of_the_machine_is_reported(xvfb: str) -> None:
    outcome = command("doctor", "--json", **NO_SCREEN | {"DISPLAY": xvfb})
    report = json.loads(outcome.stdout)
    states = {finding["subject"]: finding["state"] for finding in report["findings"]}
    assert report["ready"] is True
    for device in ("camera", "sound"):  # test machines have no camera and no sound device
        assert states.pop(device) in ("ok", "note")
    assert set(states.values()) == {"ok"}
    packages = {"numpy", "scipy", "moderngl", "glfw", "OpenEXR", "opencv-contrib-python-headless", "av", "tomli-w"}
    rest = {"Python", "OpenGL through EGL", "window system", "monitor", "FFmpeg", "OpenEXR files", "cores"}
    rest |= {"plots of studies", "camera RAW", "machine-vision cameras", "letters"}
    rest |= {"remote in a browser", "its address as a QR code", "Open Sound Control"}
    assert packages | rest <= set(states)


def test_both_monitors_are_reported(two_monitors: str) -> None:
    report = command("doctor", **NO_SCREEN | {"DISPLAY": two_monitors}).stdout
    assert "monitor: 0 DUMMY0 (1280x720 at 0,0," in report
    assert "monitor: 1 DUMMY1 (1024x768 at 1280,0," in report


def test_without_opengl_the_doctor_names_the_fix(tmp_path: Path) -> None:
    outcome = command("doctor", **NO_SCREEN, __EGL_VENDOR_LIBRARY_DIRS=str(tmp_path))
    assert outcome.returncode == BAD_INPUT
    assert outcome.stderr == ""
    lines = outcome.stdout.splitlines()
    (missing,) = (index for index, line in enumerate(lines) if line.startswith("missing OpenGL through EGL"))
    assert lines[missing + 1].split() == ["fix:", "unset", "__EGL_VENDOR_LIBRARY_DIRS"]
    assert lines[-1].startswith("not ready")


def test_a_missing_package_is_reported_with_the_command_that_installs_it(tmp_path: Path) -> None:
    hidden = tmp_path / "sitecustomize.py"
    hidden.write_text("import sys\nsys.modules |= {'OpenEXR': None, 'tqdm': None}\n")  # like a broken installation
    outcome = command("doctor", "--json", **NO_SCREEN, PYTHONPATH=str(tmp_path))
    assert outcome.returncode == BAD_INPUT
    findings = {finding["subject"]: finding for finding in json.loads(outcome.stdout)["findings"]}
    assert {findings[name]["state"] for name in ("OpenEXR", "OpenEXR files", "tqdm")} == {"missing"}
    assert "pip install 'OpenEXR>=" in findings["OpenEXR"]["fix"]


def test_what_only_some_cameras_need_is_a_note_with_its_fix(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(check_machine, "EXTRAS", (("camera RAW", "no_such_package", "raw"),))
    (finding,) = check_machine.check_extras()
    assert (finding.subject, finding.state) == ("camera RAW", "note")
    assert finding.fix == f"{sys.executable} -m pip install 'counterlight[raw]'"


def test_wrong_use_is_one_line() -> None:
    for word in ("--colour", " "):
        outcome = command("doctor", word)
        assert outcome.returncode == BAD_INPUT
        assert outcome.stderr.splitlines() == [
            f"error: counterlight doctor: unrecognized arguments: {word}; see counterlight doctor --help"
        ]


@pytest.mark.parametrize(("user", "sudo"), [(0, ""), (1000, "sudo ")])
def test_the_line_to_run_asks_for_root_only_where_needed(monkeypatch: pytest.MonkeyPatch, user: int, sudo: str) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: user)
    line = f"{sudo}apt-get update && {sudo}apt-get install --yes --no-install-recommends libegl1 libgl1"
    assert system_packages.apt_line(["libegl1", "libgl1"]) == line


def test_the_player_names_packages_of_the_doctor() -> None:
    assert set(PACKAGES.split()) <= {part.package for part in system_packages.PLAY}


def test_a_plain_user_reads_what_to_run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    parts = (Part("there", lambda: True, ""), Part("libabsent1", lambda: False, ""))
    monkeypatch.setitem(system_packages.SETS, "play", parts)
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    assert system_packages.main(["play"]) == BAD_INPUT
    assert capsys.readouterr().err.splitlines()[-1].endswith("--no-install-recommends libabsent1")


def test_root_installs_only_what_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    installed: list[str] = []
    parts = (Part("there", lambda: True, ""), Part("libabsent1", lambda: "libabsent1" in installed, ""))
    monkeypatch.setitem(system_packages.SETS, "test", parts)
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    monkeypatch.setattr(system_packages, "runs", lambda program: program == "apt-get")
    monkeypatch.setattr(system_packages, "install", installed.extend)
    assert system_packages.main(["test"]) == DONE
    assert installed == ["libabsent1"]


def test_a_program_or_library_that_is_not_there_is_seen() -> None:
    assert system_packages.loads("libc.so.6")
    assert not system_packages.loads("libnot-on-any-machine.so.1")
    assert system_packages.runs("sh")
    assert not system_packages.runs("not-on-any-machine")

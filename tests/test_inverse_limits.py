"""Refusals of counterlight build; neither a refusal nor Ctrl-C changes the existing map."""

import os
import pty
import signal
import subprocess
import termios
import tomllib
from pathlib import Path

import numpy as np
import pytest

from counterlight.errors import InputError
from counterlight.files.manifest import describe_files
from counterlight.memory import available_bytes
from counterlight.tools import build_correction_map
from counterlight.tools.inverse import memory
from counterlight.tools.inverse.near_light import InverseOptions, invert_near_light
from counterlight.tools.inverse.rows import Piece
from counterlight.tools.transport.transport import stacked
from tests.programs import command, verb
from tests.rooms import blurred_transport, write_blurred_room

CAMERA, PROJECTOR = (15, 19), (12, 16)
BUILD = "build"


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build a room with a map of 1200 projector pixels in one cluster."""
    folder = tmp_path_factory.mktemp("rooms") / "wall"
    write_blurred_room(folder, np.random.default_rng(7))
    done = command(BUILD, folder, "--regularize", "0.1", "--verbose")
    assert done.returncode == 0, done.stderr
    assert "windowed: one cluster of 1 200 projector pixels is beyond the 1 000 inverted whole" in done.stdout
    return folder


def test_the_manifest_says_what_was_done_and_why(built: Path) -> None:
    inverse = tomllib.loads((built / "correction" / "manifest.toml").read_text())["inverse"]
    assert inverse["method"] == "windowed"
    assert inverse["method_reason"] == "one cluster of 1 200 projector pixels is beyond the 1 000 inverted whole"
    assert sum(inverse["window_halos"].values()) == 6  # blocks of 16x16 in 40x30
    assert inverse["window_residual"] <= 0.5 / 255


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (["--regularize", "-0.1"], "--regularize -0.1: expected auto, none, or a number from 0 to 1"),
        (["--regularize", "nan"], "--regularize nan: expected auto, none"),
        (["--regularize", "strong"], "expected auto, none or a number from 0 to 1, found 'strong'"),
        (["--max-error", "-1"], "--max-error -1.0: expected 0 to 255 (code values)"),
        (["--max-cluster", "0"], "--max-cluster 0: expected at least 1 projector pixel"),
        (["--max-cluster", "-5"], "--max-cluster -5: expected at least 1 projector pixel"),
        (["--max-cluster", "1201"], "--max-cluster 1201: the projector has 1200 pixels; expected at most that"),
        (["--max-cluster", "many"], "invalid int value: 'many'"),
        (["--noise", "-1"], "--noise -1.0: expected 0 up to 1"),
        (["--noise", "nan"], "--noise nan: expected 0 up to 1"),
        (["--inverse", "none", "--noise", "0.1"], "--noise 0.1: --inverse none inverts nothing; leave one of them out"),
        (["--inverse", "none", "--regularize", "0.5"], "--regularize 0.5: --inverse none inverts nothing"),
        (["--method", "windowed"], "unrecognized arguments: --method windowed"),
    ],
)
def test_impossible_options_are_one_line_and_change_nothing(
    built: Path, capsys: pytest.CaptureFixture[str], options: list[str], complaint: str
) -> None:
    before = describe_files(built)
    assert build_correction_map.main([str(built), *options]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("error: ")
    assert printed.err.count("\n") == 1
    assert complaint in printed.err
    assert describe_files(built) == before


@pytest.mark.parametrize(
    ("largest_dense", "complaint"),
    [
        (1000, "inverting large clusters through windows needs about"),
        (1200, "inverting clusters of up to 1200 projector pixels whole needs about"),
    ],
)
def test_an_inverse_that_cannot_fit_is_refused_before_the_work(
    built: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    largest_dense: int,
    complaint: str,
) -> None:
    before = describe_files(built)
    # enough memory for the room and its maps
    monkeypatch.setattr("counterlight.memory.available_bytes", lambda: 20 << 20)
    monkeypatch.setattr("counterlight.tools.inverse.method.LARGEST_DENSE", largest_dense)
    assert build_correction_map.main([str(built), "--inverse", "whole", "--regularize", "0.1"]) == 2
    line = capsys.readouterr().err
    assert complaint in line
    assert "use --inverse cut" in line
    assert describe_files(built) == before


@pytest.mark.parametrize(
    ("kib", "largest_dense", "options", "complaint"),
    [
        (16, 192, InverseOptions(0.1, 0.5), "inverting clusters of up to 192 projector pixels whole"),
        (16, 191, InverseOptions(0.1, 0.5, inverse="whole"), "through windows needs .* --inverse cut"),
        (100 << 10, 192, InverseOptions(None, 0.0), None),
    ],
)
def test_every_need_is_compared_with_what_there_is(
    rng: np.random.Generator,
    monkeypatch: pytest.MonkeyPatch,
    kib: int,
    largest_dense: int,
    options: InverseOptions,
    complaint: str | None,
) -> None:
    monkeypatch.setattr("counterlight.tools.inverse.method.LARGEST_DENSE", largest_dense)
    monkeypatch.setattr("counterlight.memory.available_bytes", lambda: kib << 10)
    near = stacked((blurred_transport(rng, CAMERA, PROJECTOR, 0.6),) * 3)
    arguments = near, np.ones(CAMERA, bool), PROJECTOR, np.full((CAMERA[0] * CAMERA[1], 3), 0.5), 0.5, options
    if complaint is None:
        invert_near_light(*arguments)
        return
    with pytest.raises(InputError, match=complaint):
        invert_near_light(*arguments)


def test_a_map_that_cannot_fit_is_refused_from_its_first_rows(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    near = stacked((blurred_transport(rng, CAMERA, PROJECTOR, 0.6),) * 3)
    arguments = near, np.ones(CAMERA, bool), PROJECTOR, np.full((CAMERA[0] * CAMERA[1], 3), 0.5), 0.5
    short, long = (InverseOptions(0.4, max_error, inverse="whole") for max_error in (4.0, 0.0))
    # clusters are now inverted through windows
    monkeypatch.setattr("counterlight.tools.inverse.method.LARGEST_DENSE", 100)
    needs = [invert_near_light(*arguments, each).T_pinv.indices.size * memory.ENTRY_BYTES for each in (short, long)]
    monkeypatch.setattr("counterlight.memory.available_bytes", lambda: sum(needs) // 2)
    monkeypatch.setattr(memory, "check_windows", lambda *_: None)  # enough memory for the work itself
    invert_near_light(*arguments, short)
    with pytest.raises(InputError, match=r"correction map, of about 0 million entries, needs .* --max-error"):
        invert_near_light(*arguments, long)


def test_small_clusters_beside_large_ones_do_not_make_a_map_look_small(monkeypatch: pytest.MonkeyPatch) -> None:
    """In a large room, most rows belong to tiny clusters, which are quick, while most entries belong to windows."""
    whole, windowed, each = 9000, 1000, 500

    def pieces(first: int, count: int, entries: int, halo: int) -> Piece:
        rows, lengths = np.arange(first, first + count), np.full(count, entries)
        columns, weights = np.zeros(count * entries, np.int32), np.ones((count * entries, 3), np.float32)
        return Piece(rows, lengths, columns, weights, np.zeros((count, 3)), np.zeros(count), halo)

    made = [pieces(0, whole, 1, 0), *(pieces(whole + 20 * i, 20, each, 4) for i in range(windowed // 20))]
    needed = memory.ENTRY_BYTES * (whole + windowed * each)
    monkeypatch.setattr("counterlight.memory.available_bytes", lambda: needed)
    assert list(memory.checked_as_they_come(made, whole, windowed, memory.ENTRY_BYTES)) == made
    monkeypatch.setattr("counterlight.memory.available_bytes", lambda: needed // 2)
    coming = memory.checked_as_they_come(made, whole, windowed, memory.ENTRY_BYTES)
    assert next(coming) is made[0]
    with pytest.raises(InputError, match="about 1 million entries"):
        next(coming)


def test_available_memory_is_that_of_this_machine() -> None:
    installed = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    assert 0 < available_bytes() <= installed


def test_the_size_of_the_normal_matrix_is_foretold(rng: np.random.Generator) -> None:
    T = blurred_transport(rng, CAMERA, PROJECTOR, 0.6)
    assert memory.normal_entries(T) == pytest.approx((T.T @ T).nnz, rel=0.1)  # a third of the columns are sampled


def test_an_interrupt_leaves_the_previous_map(tmp_path: Path, built: Path) -> None:
    """Ctrl-C during the inversion, which is recognised by its progress bar on a terminal."""
    room = tmp_path / "wall"
    write_blurred_room(room, np.random.default_rng(7), (45, 64), (48, 64))
    first = command(BUILD, room, "--max-cluster", "60", "--regularize", "0.1")
    assert first.returncode == 0, first.stderr
    before = describe_files(room)
    terminal, theirs = pty.openpty()
    termios.tcsetwinsize(theirs, (24, 80))
    slow = [room, "--inverse", "whole", "--regularize", "0.001", "--max-error", "0"]
    program = subprocess.Popen([*verb(BUILD), *slow], stdout=subprocess.PIPE, stderr=theirs)
    os.close(theirs)
    printed = b""
    while b"inverting" not in printed:
        printed += os.read(terminal, 1024)
    program.send_signal(signal.SIGINT)
    output = program.communicate(timeout=300)[0]
    while b"interrupted" not in printed:
        printed += os.read(terminal, 1024)
    os.close(terminal)
    assert (program.returncode, output) == (130, b"")
    assert b"Traceback" not in printed
    assert describe_files(room) == before
    assert not list(room.glob(".correction*"))  # no stage remains

"""counterlight play and counterlight build as a user runs them: whole commands, real files, EGL."""

import json
import re
import shutil
from fractions import Fraction
from pathlib import Path

import av
import cv2
import moderngl
import numpy as np
import pytest
from scipy import sparse

from counterlight import app, calibration
from counterlight.errors import InputError
from counterlight.files import exr
from counterlight.gl.context import in_software
from counterlight.maps import room_maps as maps
from counterlight.pipeline.operators import drive_of
from counterlight.pipeline.placement import write_placement
from counterlight.pipeline.renderer import AnyRenderer
from counterlight.pipeline.room import read_room
from counterlight.show import output
from counterlight.show.command_line import read_options
from counterlight.show.from_options import governor_of, path_of, room_of
from counterlight.show.options import WITHOUT_COMPENSATION
from counterlight.tools import build_correction_map
from counterlight.tools.shipped import CLIP
from counterlight.tools.solve.box import Box
from counterlight.tools.transport.objective import DEFAULT_AIMS, objective_of
from counterlight.tools.transport.transport import Transport
from tests.programs import command, error_here, fail, here, on, succeed
from tests.rooms import write_blurred_room

ROOM_CAMERA, ROOM_PROJECTOR = (36, 50), (30, 40)


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Transport]:
    folder = tmp_path_factory.mktemp("rooms") / "wall"
    transport = write_blurred_room(folder, np.random.default_rng(7), ROOM_CAMERA, ROOM_PROJECTOR)
    out = succeed("build", folder, "--regularize", "0.02", "--max-error", "0.1", "--verbose")
    assert re.search(r"clusters, largest .* entries, texture \d+x\d+, fill 9\d\.\d %", out)
    return folder, transport


@pytest.fixture
def room(built: tuple[Path, Transport], tmp_path: Path) -> Path:
    """Return a copy that a test may damage."""
    shutil.copytree(built[0], tmp_path / "wall")
    return tmp_path / "wall"


@pytest.fixture
def target(rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(0, 0.3, (*ROOM_CAMERA, 3)).astype(np.float32)


@pytest.mark.parametrize("backend", ["gl", "cpu"])
def test_an_exr_is_compensated_as_the_equation_says(
    room: Path, tmp_path: Path, target: np.ndarray, backend: str
) -> None:
    exr.write_rgb(tmp_path / "c.exr", target)
    files = room, tmp_path / "c.exr", "--output", tmp_path / "p.exr"
    succeed("play", *files, "--backend", backend, "--refine", "0")
    stored = calibration.read(room)
    expected = np.clip(drive_of(maps.read_maps(stored), target - stored.calibration.ambient), 0, 1)
    # the tolerance that the product promises
    np.testing.assert_allclose(exr.read_rgb(tmp_path / "p.exr"), expected, atol=1e-5)


def test_imported_matrices_are_played_through_numpys_pseudo_inverse(tmp_path: Path, rng: np.random.Generator) -> None:
    """The chain import, build, play agrees with numpy.linalg.pinv."""
    camera = 8, 9
    dense = np.where(rng.uniform(size=(3, 72, 30)) < 0.12, rng.uniform(0.2, 1, (3, 72, 30)), 0).astype(np.float32)
    dense[:, :30] += np.eye(30, dtype=np.float32)  # every projector pixel is seen
    ambient = rng.uniform(0, 0.1, (*camera, 3)).astype(np.float32)
    np.save(tmp_path / "e.npy", ambient)
    colours = ("red", "green", "blue")
    for name, matrix in zip(colours, dense, strict=True):
        sparse.save_npz(tmp_path / f"{name}.npz", sparse.csr_array(matrix))
    cv2.imwrite(str(tmp_path / "mask.png"), np.full(camera, 255, np.uint8))
    matrices = [word for name in colours for word in (f"--{name}", tmp_path / f"{name}.npz")]
    sizes = ["--camera", "9x8", "--projector", "6x5"]
    files = ["--ambient", tmp_path / "e.npy", "--mask", tmp_path / "mask.png"]
    succeed("import-transport", *matrices, *sizes, *files, "-o", tmp_path / "room")
    succeed("build", tmp_path / "room", "--regularize", "none", "--max-error", "0")
    c = rng.uniform(0, 1, (*camera, 3)).astype(np.float32)
    exr.write_rgb(tmp_path / "c.exr", c)
    succeed("play", tmp_path / "room", tmp_path / "c.exr", "--output", tmp_path / "p.exr", "--refine", "0")
    full = dense.sum(axis=2, dtype=float).T
    light = np.clip((c.astype(float) - ambient).reshape(-1, 3), 0, full)
    drive = np.stack([np.linalg.pinv(dense[i].astype(float)) @ light[:, i] for i in range(3)], axis=1)
    result = exr.read_rgb(tmp_path / "p.exr").reshape(-1, 3)
    # the required tolerance; the L1 norm of rows is below 10
    np.testing.assert_allclose(result, np.clip(drive, 0, 1), atol=1e-5)


def test_the_camera_sees_what_was_asked_for(built: tuple[Path, Transport], tmp_path: Path, target: np.ndarray) -> None:
    """A picture that some drive produces exactly comes back through the true T."""
    folder, transport = built
    stored = calibration.read(folder)
    drive = cv2.GaussianBlur(np.random.default_rng(3).uniform(0.2, 0.8, (*ROOM_PROJECTOR, 3)), (0, 0), 2)
    asked = transport.apply(drive.reshape(-1, 3)).reshape(*ROOM_CAMERA, 3) + stored.calibration.ambient
    exr.write_rgb(tmp_path / "c.exr", asked.astype(np.float32))
    files = folder, tmp_path / "c.exr", "--output", tmp_path / "seen.exr"
    here("play", *files, "--view", "camera", "--refine", "0")
    seen = exr.read_rgb(tmp_path / "seen.exr")
    # damping of 0.02 σ₁ shrinks the result by about λ²/σ²
    assert np.sqrt(np.mean((seen - asked) ** 2)) < 0.005 * asked.max()
    plain = transport.apply(np.clip(asked.reshape(-1, 3)[: drive.size // 3], 0, 1)).reshape(*ROOM_CAMERA, 3)
    assert np.sqrt(np.mean((plain - asked) ** 2)) > 0.05 * asked.max()  # without T⁺ the error is large


def test_a_clip_becomes_a_video_with_its_frames(room: Path, tmp_path: Path) -> None:
    output, stats = tmp_path / "out.mp4", tmp_path / "stats.json"
    succeed("play", room, CLIP, "--output", output, "--frames", 7, "--stats", stats)
    with av.open(str(output)) as container:
        frames = list(container.decode(video=0))
    assert len(frames) == 7
    assert (frames[0].width, frames[0].height) == (40, 30)
    assert frames[0].colorspace == 1  # BT.709
    numbers = json.loads(stats.read_text())
    assert (numbers["frames"], numbers["dropped"]) == (7, 0)
    assert {"decode_ms", "upload_ms", "gpu_ms"} <= numbers.keys()
    assert set(numbers["gpu_ms"]) == {"median", "p95", "p99", "max"}


def test_gl_and_cpu_render_the_same_codes(room: Path, tmp_path: Path) -> None:
    for view in ("projector", "camera", "split"):
        for backend in ("gl", "cpu"):
            out = tmp_path / f"{view}-{backend}.png"
            succeed("play", room, CLIP, "--output", out, "--view", view, "--backend", backend, "--start", "2")
        pictures = [cv2.imread(str(tmp_path / f"{view}-{backend}.png")).astype(int) for backend in ("gl", "cpu")]
        assert np.abs(pictures[0] - pictures[1]).max() <= 1  # rounding may change one code value
        assert pictures[0].std() > 5


def test_a_file_is_rendered_on_the_processor_where_no_gpu_runs_opengl(
    room: Path, tmp_path: Path, gl_context: moderngl.Context
) -> None:
    """An explicit backend or path is used on any machine, without a message."""
    software = in_software(gl_context.info["GL_RENDERER"])
    for number, (options, used) in enumerate(
        (
            ([], "cpu" if software else "fragment"),
            (["--backend", "gl"], "fragment"),
            (["--shader", "compute"], "compute"),
        )
    ):
        out, stats = tmp_path / f"{number}.png", tmp_path / "stats.json"
        said = succeed("play", room, CLIP, "--output", out, "--stats", stats, *options)
        assert json.loads(stats.read_text())["gpu_path"]["name"] == used
        assert said.count("backend: ") == (not options)


@pytest.mark.parametrize(
    ("name", "software"),
    [
        ("llvmpipe (LLVM 15.0.7, 256 bits)", True),
        ("Google SwiftShader", True),
        ("GDI Generic", True),
        ("NVIDIA H200/PCIe/SSE2", False),
        ("Mesa Intel(R) UHD Graphics 620 (KBL GT2)", False),
        ("AMD Radeon RX 6800 (radeonsi, navi21, LLVM 15.0.7)", False),
    ],
)
def test_software_is_recognised_by_the_renderers_name(name: str, software: bool) -> None:
    assert in_software(name) == software


def test_sequences_are_numbered_and_lossless(room: Path, tmp_path: Path) -> None:
    succeed("play", room, CLIP, "--output", tmp_path / "f%04d.png", "--frames", 3)
    succeed("play", room, CLIP, "--output", tmp_path / "out.mkv", "--frames", 3)
    assert sorted(path.name for path in tmp_path.glob("f*")) == ["f0000.png", "f0001.png", "f0002.png"]
    with av.open(str(tmp_path / "out.mkv")) as container:
        for index, frame in enumerate(container.decode(video=0)):
            still = cv2.imread(str(tmp_path / f"f{index:04d}.png"))
            np.testing.assert_array_equal(frame.to_ndarray(format="bgr24"), still)


def test_compensation_is_what_raises_the_psnr(room: Path, tmp_path: Path) -> None:
    figures = []
    for option in ([], ["--no-compensation"]):
        out = here("play", room, CLIP, "--output", tmp_path / "c.png", "--view", "camera", *option)
        match = re.search(r"camera PSNR (\d+\.\d) dB", out)
        assert match is not None
        figures.append(float(match.group(1)))
    assert figures[0] > figures[1] + 8


def test_refinement_approaches_the_box_optimum(built: tuple[Path, Transport], tmp_path: Path) -> None:
    """T⁺ clips on letters: the error falls with every step and ends at the CPU solver's result."""
    folder, transport = built
    stored = calibration.read(folder)
    c = np.kron(np.random.default_rng(4).choice([0.02, 0.4], (9, 10, 3)), np.ones((4, 5, 1))).astype(np.float32)
    exr.write_rgb(tmp_path / "c.exr", c)
    objective = objective_of(transport, stored.calibration, DEFAULT_AIMS)
    b = (c - stored.calibration.ambient).reshape(-1, 3).astype(float)
    best, least = (each.value(Box(each).solve(b).drive, b).sum() for each in (objective, objective.unweighted))
    errors, plain, bounds = [], [], []
    for steps in (0, 2, 8, 256):
        out, stats = tmp_path / "p.exr", tmp_path / "stats.json"
        files = folder, tmp_path / "c.exr", "--output", out, "--stats", stats
        here("play", *files, "--refine", steps)
        drive = exr.read_rgb(out).reshape(-1, 3).astype(float)
        errors.append(objective.value(drive, b).sum())
        plain.append(objective.unweighted.value(drive, b).sum())
        if steps:
            facts = json.loads(stats.read_text())["refinement"]
            assert facts["steps"] == steps
            bounds.append(np.inf if facts["certified_db"] is None else facts["certified_db"])
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] == pytest.approx(best, rel=1e-3)  # the solver's gap is 1e-4
    assert errors[0] > 1.1 * best
    assert all(10 * np.log10(error / least) <= bound + 1e-3 for error, bound in zip(plain[1:], bounds, strict=True))
    assert bounds[-1] < 1


def test_a_map_without_refinement_plays_and_says_what_is_missing(room: Path, tmp_path: Path) -> None:
    out = tmp_path / "o.png"
    summary = succeed("build", room, "--regularize", "0.1", "--no-refine", "--verbose")
    assert {path.name for path in (room / "correction").iterdir() if path.is_dir()} == {"transport"}
    succeed("play", room, CLIP, "--output", out)
    for option in (["--refine", "4"], ["--refine-from", "grey"]):
        line = fail("play", room, CLIP, "--output", out, *option)
        assert "built without what refinement needs; rebuild them with: counterlight build" in line
    succeed("play", room, CLIP, "--output", out, "--refine", "0")
    sizes = [float(re.findall(r"([\d.]+) MiB", text)[0]) for text in (summary, succeed("build", room, "--verbose"))]
    assert sizes[0] < sizes[1]


@pytest.mark.parametrize(
    "words",
    [
        ["--budget", "20"],
        ["--within", "0.5"],
        ["--refine-from", "map"],
        ["--entries", "words"],
        ["--refine", "auto"],
        ["--backend", "cpu"],
    ],
)
def test_the_safe_picture_starts_after_any_options_of_refinement(room: Path, words: list[str]) -> None:
    line = str(room), str(CLIP), "--no-config", *words, *WITHOUT_COMPENSATION
    options = read_options(line, "")
    read = room_of(options)
    assert read.maps.refinement is None
    assert governor_of(options, read, read.default_steps).steps == 0
    assert path_of(options).entries != "words"


@pytest.mark.parametrize(
    "file",
    ["lookup.exr", "entries.exr", "transport/entries.exr", "dual/entries.exr", "direct/lookup.exr", "step_size.exr"],
)
@pytest.mark.parametrize("damage", ["truncated", "flipped", "missing"])
def test_a_damaged_map_is_refused(room: Path, file: str, damage: str) -> None:
    path = room / "correction" / file
    contents = bytearray(path.read_bytes())
    if damage == "missing":
        path.unlink()
    else:
        contents[-100] ^= 4
        path.write_bytes(contents if damage == "flipped" else contents[: len(contents) // 2])
    with pytest.raises(InputError, match=rf"{file}.*rebuild it with: counterlight build {room}"):
        read_room(room, None)


def test_a_damaged_map_ends_a_command_before_its_output_begins(room: Path, tmp_path: Path) -> None:
    path = room / "correction" / "entries.exr"
    path.write_bytes(path.read_bytes()[:-1])
    assert "entries.exr: " in fail("play", room, CLIP, "--output", tmp_path / "out.png")
    assert not (tmp_path / "out.png").exists()


def test_a_map_of_another_calibration_is_refused(room: Path, tmp_path: Path) -> None:
    write_blurred_room(tmp_path / "other", np.random.default_rng(8), ROOM_CAMERA, ROOM_PROJECTOR)
    shutil.copytree(room / "correction", tmp_path / "other" / "correction")
    line = fail("play", tmp_path / "other", CLIP, "--output", tmp_path / "out.png")
    assert "made for another state" in line


def test_no_map_yet(tmp_path: Path) -> None:
    write_blurred_room(tmp_path / "wall", np.random.default_rng(8))
    line = fail("play", tmp_path / "wall", CLIP, "--output", tmp_path / "out.png")
    assert "missing; rebuild it with: counterlight build" in line


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["nowhere", "CLIP", "--output", "OUT/o.png"], "nowhere: no such folder"),
        # the medium is checked before the room is read
        (["nowhere", "OUT/none.mp4", "--output", "OUT/o.png"], "none.mp4: no such file"),
        (["nowhere", "CLIP", "--screenshot-directory", "OUT/none"], "no such folder for --screenshot-directory"),
        (["ROOM", "CLIP", "--output", "OUT/o.tiff"], "cannot write .tiff"),
        (["ROOM", "CLIP", "--output", "OUT/no/o.png"], "no such folder"),
        (["ROOM", "CLIP", "--output", "OUT/o%03d.mp4"], "only .png and .exr are numbered"),
        (["ROOM", "CLIP", "--white", "0"], "expected auto or a radiance from 1e-12"),
        (["ROOM", "CLIP", "--white", "nan"], "expected auto or a radiance from 1e-12"),
        (["ROOM", "CLIP", "--frames", "0"], "from 1"),
        (["ROOM", "CLIP", "--view", "side"], "invalid choice: 'side'"),
        (
            ["ROOM", "CLIP", "--backend", "cpu", "--entries", "auto"],
            "--entries auto: --backend cpu has no GPU to use it",
        ),
        ([], "a room and a medium are missing; for example: counterlight play room film.mp4"),
        (["CLIP"], f"the room of {CLIP} is missing; for example: counterlight play room {CLIP}"),
        (["ROOM"], "wall film.mp4"),
        (["ROOM.old", "CLIP", "--output", "OUT/o.png"], "no such folder; did you mean 'wall'?; measure a room"),
        (["ROOM", "CLIP", "--start", "99", "--output", "OUT/o.png"], "no frame to render"),
        (["ROOM", "CLIP", "--loop", "--output", "OUT/o.mp4"], "never ends"),
        (["ROOM", "CLIP", "--output", "OUT/o.png", "--refine", "-1"], "auto or a number of steps from 0 to 256"),
        (["ROOM", "CLIP", "--output", "OUT/o.png", "--refine", "257"], "auto or a number of steps from 0 to 256"),
        (["ROOM", "CLIP", "--output", "OUT/o.png", "--refine", "auto"], "a file has no time to keep"),
        (["ROOM", "CLIP", "--output", "OUT/o.png", "--refine-from", "white"], "invalid choice: 'white'"),
        (["ROOM", "CLIP", "--refine", "0", "--refine-from", "map"], "makes no step that could start there"),
        (["ROOM", "CLIP", "--output", "OUT/o.png", "--stats", "OUT/no/s.json"], "no: no such folder; make it first"),
        (["ROOM", "CLIP", "--frames", "1", "--output", "/proc/o.png"], "/proc/o.png: cannot be written"),
        (["ROOM", "CLIP", "--frames", "1", "--output", "/proc/o.mp4"], "/proc/o.mp4: cannot be written"),
        (["ROOM", "CLIP", "--frames", "1", "--output", "/proc/o%d.exr"], "cannot be written"),
    ],
)
def test_wrong_use_is_one_line(
    room: Path, tmp_path: Path, arguments: list[str], complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    names = {"ROOM": str(room), "CLIP": str(CLIP)}
    words = [names.get(word, word.replace("OUT", str(tmp_path)).replace("ROOM", str(room))) for word in arguments]
    assert complaint in error_here(app.main, capsys, *words)
    assert [path.name for path in tmp_path.iterdir()] == ["wall"]


def test_no_screen_and_no_egl(room: Path, tmp_path: Path) -> None:
    assert "no screen" in fail("play", room, CLIP, **on(""))
    assert "no screen" in fail("play", "--list-monitors", **on(""))
    nothing = tmp_path / "empty"
    nothing.mkdir()
    into, without = ("play", room, CLIP, "--output", tmp_path / "o.png"), str(nothing)
    line = fail(*into, "--backend", "gl", __EGL_VENDOR_LIBRARY_DIRS=without)
    assert "no OpenGL through EGL" in line
    assert "--backend cpu" in line
    assert not (tmp_path / "o.png").exists()
    write_placement(room, ((-1.0, 0.0), (1.0, 0.0), (1.0, 1.0), (-1.0, 1.0)))
    done = command(*into, __EGL_VENDOR_LIBRARY_DIRS=without)
    assert "backend: cpu, there is no OpenGL" in done.stdout
    assert re.search(r"^[5-9]\d % of the picture lies beyond the projector's light; key k", done.stderr, re.MULTILINE)
    assert (tmp_path / "o.png").exists()


def test_a_clip_that_ends_early_leaves_no_output(
    room: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    clip = tmp_path / "clip.mkv"
    with av.open(str(clip), "w") as container:
        stream = container.add_stream("mpeg4", rate=25)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for index in range(50):
            picture = np.random.default_rng(index).integers(0, 255, (48, 64, 3), np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode(None))
    clip.write_bytes(clip.read_bytes()[: clip.stat().st_size // 2])
    for name in ("o.mp4", "o.mkv", "o%02d.png"):
        assert "ends early" in error_here(app.main, capsys, room, clip, "--output", tmp_path / name)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["clip.mkv", "wall"]


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--regularize", "-1"], "from 0 to 1"),
        (["--regularize", "much"], "expected auto, none or a number"),
        (["--max-error", "-1"], "expected 0 to 255"),
    ],
)
def test_build_correction_map_refuses_wrong_options(
    room: Path, arguments: list[str], complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    before = (room / "correction" / "manifest.toml").read_bytes()
    assert complaint in error_here(build_correction_map.main, capsys, room, *arguments)
    assert (room / "correction" / "manifest.toml").read_bytes() == before


def test_a_damaged_transport_keeps_the_previous_map(room: Path) -> None:
    before = (room / "correction" / "manifest.toml").read_bytes()
    path = room / "transport_green.npz"
    path.write_bytes(path.read_bytes()[:-20])
    assert "transport_green.npz" in fail("build", room)
    assert (room / "correction" / "manifest.toml").read_bytes() == before
    assert [path.name for path in room.parent.iterdir()] == ["wall"]


def test_an_interrupt_leaves_the_previous_map(
    room: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    before = (room / "correction" / "manifest.toml").read_bytes()
    for step in (
        "counterlight.maps.row_map.write",
        "counterlight.tools.inverse.near_light.join",
    ):  # one signal during writing, one during computing
        with monkeypatch.context() as patch:
            patch.setattr(step, interrupted)
            assert build_correction_map.main([str(room)]) == 130
        assert capsys.readouterr().err.strip() == "interrupted: nothing half-written remains"
        assert (room / "correction" / "manifest.toml").read_bytes() == before
        assert [path.name for path in room.parent.iterdir()] == ["wall"]
        assert not list(room.glob(".*"))


def test_a_sequence_is_replaced_as_a_whole_or_not_at_all(
    room: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The existing sequence is longer than the new one, and its extra frames are removed."""
    frames = [tmp_path / f"f{index:03d}.png" for index in range(5)]
    for index, frame in enumerate(frames):
        cv2.imwrite(str(frame), np.full((30, 40, 3), 40 * index + 40, np.uint8))
    before = [frame.read_bytes() for frame in frames]
    arguments = [str(room), str(CLIP), "--frames", "3", "--output", str(tmp_path / "f%03d.png")]
    writing = output.write_picture

    def interrupted(path: Path, renderer: AnyRenderer) -> None:
        if path.name == "f002.png":
            raise KeyboardInterrupt
        writing(path, renderer)

    with monkeypatch.context() as patch:
        patch.setattr(output, "write_picture", interrupted)
        assert app.main(arguments) == 130
    assert [frame.read_bytes() for frame in frames] == before
    assert app.main(arguments) == 0
    assert all(frame.read_bytes() != old for frame, old in zip(frames[:3], before, strict=False))
    assert sorted(path.name for path in tmp_path.iterdir()) == [*(frame.name for frame in frames[:3]), "wall"]


@pytest.mark.parametrize("suffix", [".mp4", ".mkv"])
def test_frames_keep_their_times(room: Path, tmp_path: Path, suffix: str) -> None:
    """A clip with frames of different durations is written to a name with a colon."""
    times = [0.0, 0.04, 1.04, 1.08, 3.08, 3.12]
    clip, rendered = tmp_path / "clip.mkv", tmp_path / f"12:30{suffix}"
    with av.open(str(clip), "w") as container:
        stream = container.add_stream("ffv1", rate=25)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for time_s in times:
            frame = av.VideoFrame.from_ndarray(np.full((48, 64, 3), 90, np.uint8), format="rgb24")
            frame.pts, frame.time_base = round(time_s * 1000), Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    here("play", room, clip, "--output", rendered)
    with av.open(f"file:{rendered}") as container:
        found = [float(frame.time) for frame in container.decode(video=0)]
    np.testing.assert_allclose(found, times, atol=1.1e-3)  # Matroska states times in milliseconds

"""The Python API: docs/api.md as it is printed, against independent products, and what importing costs."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import sparse

import counterlight as cl
from counterlight.errors import InputError
from counterlight.files.png import write_png
from counterlight.response import Response
from counterlight.tools.transport.objective import DEFAULT_AIMS, objective_of
from tests.augmented import best, value
from tests.pixel_orders import smooth
from tests.programs import ROOT, python, succeed

PAGE = (ROOT / "docs" / "api.md").read_text()
GIVEN: dict[str, Any] = {"camera": (12, 16), "projector": (9, 14), "response": "srgb"}


@pytest.fixture(scope="module")
def matrices() -> list[sparse.csr_array]:
    rng = np.random.default_rng(5)
    shape = 12 * 16, 9 * 14
    return [sparse.random_array(shape, density=0.05, rng=rng, dtype=np.float32).tocsr() for _ in range(3)]


@pytest.fixture(scope="module")
def room(matrices: list[sparse.csr_array]) -> cl.Room:
    return cl.Room.from_matrices(*matrices, **GIVEN, ambient=0.01, mask=np.ones((12, 16), bool))


def test_the_page_runs_as_it_is_printed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(3)
    write_png(tmp_path / "frame.png", rng.integers(30, 200, (60, 100, 3)).astype(np.uint8))
    blocks = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    assert len(blocks) == 7
    names: dict[str, object] = {}
    for block in blocks:
        exec(compile(block, "docs/api.md", "exec"), names)
    drive, found, maps, same = names["drive"], names["found"], names["maps"], names["same"]
    assert drive.shape == (48, 80, 3)
    assert 0 <= drive.min() <= drive.max() <= 1
    assert found.below_optimum < 0.1
    assert np.array_equal(same.correction.entries, maps.correction.entries)
    assert "frames" in succeed("play", "room", "frame.png", "--no-config", "--output", "drive.png")


def test_a_room_of_matrices_is_what_scipy_says(room: cl.Room, matrices: list[sparse.csr_array]) -> None:
    rng = np.random.default_rng(6)
    p, c = rng.random((9, 14, 3)), rng.random((12, 16, 3))
    forth = np.stack([T @ p[..., i].ravel() for i, T in enumerate(matrices)], axis=-1).reshape(12, 16, 3)
    back = np.stack([T.T @ c[..., i].ravel() for i, T in enumerate(matrices)], axis=-1).reshape(9, 14, 3)
    np.testing.assert_allclose(room.transport @ p, forth, rtol=1e-5, atol=1e-6)  # float32 weights
    np.testing.assert_allclose(room.transport.T @ c, back, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(room.seen(p), forth + 0.01, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(room.floodlight, room.seen(np.ones(3)), rtol=1e-6)


@pytest.mark.parametrize(
    ("shape", "complaint"),
    [
        ((14, 9, 3), r"shape \(14, 9, 3\), expected \(9, 14, 3\) or \(126, 3\); width and height are swapped"),
        ((6, 21, 3), r"shape \(6, 21, 3\), expected \(9, 14, 3\)"),
        ((9, 14), r"shape \(9, 14\), expected \(9, 14, 3\)"),
        ((1, 9, 14, 3), r"shape \(1, 9, 14, 3\), expected"),
        ((125, 3), r"shape \(125, 3\), expected"),
        ((), r"shape \(\), expected"),
    ],
)
def test_light_of_another_shape_is_told(room: cl.Room, shape: tuple[int, ...], complaint: str) -> None:
    for T in (room.transport, room.transport.T.T):
        with pytest.raises(InputError, match=complaint):
            T @ np.ones(shape)
    with pytest.raises(InputError, match=r"shape \(16, 12, 3\), expected \(12, 16, 3\) .*swapped"):
        room.transport.T @ np.ones((16, 12, 3))


def test_light_is_floating_point(room: cl.Room) -> None:
    for codes in (np.ones((9, 14, 3), np.uint8), np.ones((126, 3), int), np.ones((9, 14, 3), complex)):
        with pytest.raises(InputError, match="light as .*, expected linear light in floating point"):
            room.transport @ codes
    lit = np.zeros((9, 14, 3), bool)
    lit[3:5] = True
    np.testing.assert_array_equal(room.transport @ lit, room.transport @ lit.astype(float))
    np.testing.assert_array_equal(room.transport @ lit.astype(float).tolist(), room.transport @ lit)


def test_the_box_solution_is_scipys(room: cl.Room) -> None:
    picture = np.random.default_rng(7).random((12, 16, 3))
    found = cl.solve(room, picture, white=0.4)
    objective = objective_of(room.transport, room.calibration, DEFAULT_AIMS)
    b, drive = (0.4 * picture - room.ambient).reshape(-1, 3), found.drive.reshape(-1, 3)
    for i in range(3):
        assert value(objective, drive, b, i) <= best(objective, b, i) * (1 + 1e-3)  # the solver proves 1e-4 of it
    assert found.below_optimum < 0.01


def test_nothing_is_written_and_backends_agree(room: cl.Room, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    maps = cl.build_maps(room, damping=0.1, max_error=0.0)
    picture, drives = np.random.default_rng(8).random((12, 16, 3)), []
    for backend in ("gl", "cpu"):
        with cl.Renderer(room, maps, backend=backend) as renderer:
            drives.append(renderer.render(picture, refine=3))
            np.testing.assert_allclose(renderer.camera_view(), room.seen(drives[-1]), atol=1e-4)
    np.testing.assert_allclose(*drives, atol=1e-4)
    assert list(tmp_path.iterdir()) == []


def test_maps_from_memory_are_those_of_the_command(room: cl.Room, tmp_path: Path) -> None:
    room.write(tmp_path / "room")
    succeed("build", tmp_path / "room", "--preset", "balanced", "--regularize", "0.1")
    written, made = (
        cl.read_maps(tmp_path / "room"),
        cl.build_maps(cl.read_room(tmp_path / "room"), "balanced", damping=0.1),
    )
    assert written.named().keys() == made.named().keys()
    for name, packed in made.named().items():
        np.testing.assert_array_equal(written.named()[name].entries, packed.entries)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"camera": (12, 15)}, "192x126 entries, expected 180 camera pixels"),
        ({"ambient": np.zeros((3, 3, 3))}, "ambient of shape"),
        ({"ambient": np.nan}, "NaN or infinity"),
        ({"mask": np.ones((3, 3), bool)}, "mask of shape"),
        ({"response": "gamma"}, "response"),
    ],
)
def test_matrices_that_do_not_fit_are_told(
    matrices: list[sparse.csr_array], change: dict[str, object], complaint: str
) -> None:
    with pytest.raises(InputError, match=complaint):
        cl.Room.from_matrices(*matrices, **(GIVEN | change))


@pytest.mark.parametrize("swapped", ["camera", "projector"])
def test_swapped_sizes_are_told_by_a_warning(swapped: str) -> None:
    T = smooth(np.random.default_rng(3), (18, 24), (15, 20))
    given = {"camera": (18, 24), "projector": (15, 20), "response": "srgb"}
    cl.Room.from_matrices(T, T, T, **given)  # warnings are failures
    given[swapped] = given[swapped][::-1]
    with pytest.warns(
        UserWarning, match=r"scrambled for camera \(.*and smooth for camera \(18, 24\) .*\(15, 20\)"
    ) as caught:
        cl.Room.from_matrices(T, T, T, **given)
    assert caught[0].filename == __file__


def test_a_response_that_nobody_gave_is_srgb_with_a_warning(matrices: list[sparse.csr_array]) -> None:
    unsaid = {key: value for key, value in GIVEN.items() if key != "response"}
    with pytest.warns(UserWarning, match="response: sRGB assumed; measure it") as caught:
        room = cl.Room.from_matrices(*matrices, **unsaid)
    assert caught[0].filename == __file__
    assert room.calibration.projector.response == Response("srgb")


def test_wrong_pictures_and_names_are_told(room: cl.Room) -> None:
    with pytest.raises(InputError, match=r"shape \(9, 14, 3\), expected \(12, 16, 3\)"):
        cl.solve(room, np.ones((9, 14, 3)))
    with pytest.raises(InputError, match="did you mean 'nnls'"):
        cl.solve(room, np.ones(3), "nnsl")
    with pytest.raises(InputError, match="did you mean 'best'"):
        cl.build_maps(room, "bets")


def test_importing_is_free() -> None:
    code = "import sys, counterlight; print(*sorted(set(sys.modules) & {'numpy', 'scipy', 'moderngl', 'cv2', 'numba'}))"
    assert python("-c", code).split() == []
    code = "import sys, counterlight; counterlight.Room; print(*(set(sys.modules) & {'moderngl', 'scipy.optimize'}))"
    assert python("-c", code).split() == []

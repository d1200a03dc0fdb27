"""The Python API: docs/api.md runs as printed, agrees with independent programs, and imports cheaply."""

import pydoc
import re
import sys
from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy import sparse

import counterlight as cl
from counterlight.errors import InputError
from counterlight.files.picture_files import write_png
from counterlight.maps.room_maps import RoomMaps
from counterlight.response import Response, parse_response
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
def maps(room: cl.Room) -> RoomMaps:
    return cl.build_maps(room, inverse="none")


@pytest.fixture(scope="module")
def room(matrices: list[sparse.csr_array]) -> cl.Room:
    return cl.Room.from_matrices(*matrices, **GIVEN, ambient=0.01, mask=np.ones((12, 16), bool))


def test_the_page_runs_as_it_is_printed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(3)
    write_png(tmp_path / "frame.png", rng.integers(30, 200, (60, 100, 3)).astype(np.uint8))
    blocks = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    assert len(blocks) == 9
    names: dict[str, object] = {}
    for block in blocks:
        exec(compile(block, "docs/api.md", "exec"), names)
    drive, found, maps, same = names["drive"], names["found"], names["maps"], names["same"]
    assert drive.shape == (48, 80, 3)
    assert 0 <= drive.min() <= drive.max() <= 1
    assert found.below_optimum < 0.1
    assert np.array_equal(same.correction.entries, maps.correction.entries)
    assert "1 frame" in succeed("play", "room", "frame.png", "--no-config", "--output", "drive.png")


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
        ((14, 9, 3), r"shape \(14, 9, 3\), expected \(9, 14, 3\); width and height are swapped"),
        ((6, 21, 3), r"shape \(6, 21, 3\), expected \(9, 14, 3\)"),
        ((9, 14), r"shape \(9, 14\), expected \(9, 14, 3\)"),
        ((1, 9, 14, 3), r"shape \(1, 9, 14, 3\), expected"),
        ((126, 3), r"shape \(126, 3\), expected \(9, 14, 3\); or a flattened picture \(378,\)"),
        ((), r"shape \(\), expected"),
    ],
)
def test_light_of_another_shape_is_reported(room: cl.Room, shape: tuple[int, ...], complaint: str) -> None:
    for T in (room.transport, room.transport.T.T):
        with pytest.raises(InputError, match=complaint):
            T @ np.ones(shape)
    with pytest.raises(InputError, match=r"shape \(16, 12, 3\), expected \(12, 16, 3\); .*swapped"):
        room.transport.T @ np.ones((16, 12, 3))


def test_light_is_floating_point(room: cl.Room) -> None:
    for codes in (np.ones((9, 14, 3), np.uint8), np.ones(378, int), np.ones((378, 2), int)):
        with pytest.raises(InputError, match=r"light as u?int.*, expected linear light in floating point"):
            room.transport @ codes
    with pytest.raises(TypeError, match=r"light: complex128 of shape .*, expected an array of real numbers"):
        room.transport @ np.ones((9, 14, 3), complex)
    lit = np.zeros((9, 14, 3), bool)
    lit[3:5] = True
    np.testing.assert_array_equal(room.transport @ lit, room.transport @ lit.astype(float))
    np.testing.assert_array_equal(room.transport @ lit.astype(float).tolist(), room.transport @ lit)


def test_the_box_solution_is_scipys(room: cl.Room) -> None:
    picture = np.random.default_rng(7).random((12, 16, 3))
    found = cl.solve(room, picture, white=0.4)
    objective = objective_of(room.parts, room.calibration, DEFAULT_AIMS)
    b, drive = (0.4 * picture - room.ambient).reshape(-1, 3), found.drive.reshape(-1, 3)
    for i in range(3):
        # the solver proves 1e-4 relative to the optimum
        assert value(objective, drive, b, i) <= best(objective, b, i) * (1 + 1e-3)
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
    succeed("build", tmp_path / "room", "--max-error", "2", "--regularize", "0.1")
    written, made = (
        cl.read_maps(tmp_path / "room"),
        cl.build_maps(cl.read_room(tmp_path / "room"), max_error=2, damping=0.1),
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
        ({"ambient": np.full((12, 16, 3), 9, np.uint8)}, "ambient of uint8: expected radiance in one unit"),
        (
            {"ambient": -1.0},
            "ambient light: radiance from -1 to -1, .*; subtract less darkness",
        ),
        ({"ambient": 1e30}, r"ambient holds 1e\+30, expected at most 1e\+12"),
        ({"mask": np.ones((3, 3), bool)}, "mask of shape"),
        ({"mask": np.linspace(0, 1, 192).reshape(12, 16)}, "mask of float64 with many values"),
        ({"mask": np.full((12, 16), np.nan)}, "mask of float64 with many values"),
        ({"mask": np.zeros((12, 16), bool)}, "mask: no camera pixel counts"),
        ({"primaries": [np.ones((12, 16, 3)), np.ones(3)]}, r"shape \(2, 12, 16, 3\) and \(2, 3\), expected \(3, 12, "),
        ({"primaries": np.zeros((3, 12, 16, 3))}, "primaries: no light under full red and green and blue; give all"),
        ({"primaries": np.ones((12, 16, 3))}, r"primaries of shape \(12, 16, 3\), expected \(3, 12, 16, 3\)"),
        ({"response": "gamma"}, "response"),
        ({"camera": (0, 192)}, "camera height=0: expected 1 to"),
        ({"factor": -1}, "factor=-1: expected 0 to 10"),
        ({"colour": "nosuch"}, "colour='nosuch': expected one of auto"),
        ({"name": "x" * 1001}, "a name of 1001 characters"),
    ],
)
def test_matrices_that_do_not_fit_are_reported(
    matrices: list[sparse.csr_array], change: dict[str, object], complaint: str
) -> None:
    with pytest.raises(InputError, match=complaint):
        cl.Room.from_matrices(*matrices, **(GIVEN | change))


def test_a_matrix_of_another_shape_is_refused_before_it_is_converted(matrices: list[sparse.csr_array]) -> None:
    class Unread:
        def __init__(self, *shape: int) -> None:
            self.shape = shape

        def __array__(self, *_: object, **__: object) -> np.ndarray:
            raise ValueError("read")

    with pytest.raises(InputError, match="192x127 entries, expected 192 camera pixels"):
        cl.Room.from_matrices(Unread(192, 127), *matrices[1:], **GIVEN)
    with pytest.raises(TypeError, match=r"Unread is no array of numbers \(read\)"):
        cl.Room.from_matrices(Unread(192, 126), *matrices[1:], **GIVEN)


@pytest.mark.parametrize("swapped", ["camera", "projector"])
def test_swapped_sizes_are_reported_by_a_warning(swapped: str) -> None:
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


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"camera": "12x16"}, r"camera='12x16': expected \(height, width\) in pixels"),
        ({"camera": (12.0, 16.0)}, r"camera height=12\.0: expected a whole number"),
        ({"projector": (9, 14, 3)}, r"projector=\(9, 14, 3\): expected \(height, width\)"),
        ({"factor": "0"}, "factor='0': expected a number"),
        ({"name": None}, "name: expected str, found NoneType"),
        ({"ambient": "dark"}, "ambient: <U4 of shape .., expected an array of real numbers"),
        ({"ambient": np.ma.masked_less(np.ones((12, 16, 3)), 0)}, "ambient: a masked array, whose mask would be lost"),
        ({"nonsense": 1}, "nonsense"),
    ],
)
def test_another_kind_of_argument_is_reported(
    matrices: list[sparse.csr_array], change: dict[str, object], complaint: str
) -> None:
    with pytest.raises(TypeError, match=complaint):
        cl.Room.from_matrices(*matrices, **(GIVEN | change))


@pytest.mark.parametrize(
    "matrix",
    [
        None,
        "red.npz",
        np.ones((192, 126), complex),
        np.ones((192, 126), object),
        np.ones(192),
        np.ones((2, 3, 4)),
        [[1], [1, 2]],
    ],
)
def test_what_is_no_matrix_is_reported(matrices: list[sparse.csr_array], matrix: object) -> None:
    with pytest.raises((InputError, TypeError), match=r"T of the green channel: .*(expected|no array)"):
        cl.Room.from_matrices(matrices[0], matrix, matrices[2], **GIVEN)


def test_sizes_masks_and_matrices_may_be_of_any_such_kind(matrices: list[sparse.csr_array], room: cl.Room) -> None:
    dense, array, *_ = (matrix.toarray() for matrix in matrices)
    array.setflags(write=False)
    for sizes in ([12, 16], np.array([12, 16])):
        given = {"camera": sizes, "projector": (np.int64(9), 14), "response": np.float32(2.2), "factor": 0}
        mask = np.full((12, 16), 255, np.uint8)
        found = cl.Room.from_matrices(dense.tolist(), np.asfortranarray(array), matrices[2].tocoo(), **given, mask=mask)
        assert found.camera == (12, 16)
        assert found.mask.all()
        p = np.random.default_rng(3).random((9, 14, 3))
        np.testing.assert_allclose(found.transport @ p, room.transport @ p, rtol=1e-6)


CODES = np.random.default_rng(12).integers(0, 256, (12, 16, 3)).astype(np.uint8)


class Tensor:
    """Array of another library."""

    def __init__(self, values: np.ndarray) -> None:
        self._values = values

    def __array__(self, dtype: object = None, copy: object = None) -> np.ndarray:
        return self._values


class Exporter:
    """Array of a library that knows DLPack only, as tensors on a processor do."""

    def __init__(self, values: np.ndarray) -> None:
        self._values = values

    def __dlpack__(self, **options: object) -> object:
        return self._values.__dlpack__(**options)

    def __dlpack_device__(self) -> tuple[int, int]:
        return self._values.__dlpack_device__()


class OnGpu(Exporter):
    def __dlpack__(self, **options: object) -> object:
        raise BufferError("the tensor is on a GPU; copy it with .cpu()")


@pytest.mark.parametrize("kind", [Exporter, Tensor])
def test_arrays_of_other_libraries_are_taken_everywhere(
    kind: type[Exporter | Tensor], matrices: list[sparse.csr_array], room: cl.Room
) -> None:
    rng = np.random.default_rng(21)
    given = GIVEN | {"factor": 0}
    light = {
        "ambient": rng.random((12, 16, 3)),
        "mask": rng.random((12, 16)) < 0.9,
        "primaries": rng.random((3, 12, 16, 3)),
    }
    dense = [T.toarray() for T in matrices]
    expected = cl.Room.from_matrices(*dense, **given, **light)
    exported = {name: kind(values) for name, values in light.items()}
    for primaries in (exported["primaries"], [kind(each) for each in light["primaries"]]):
        found = cl.Room.from_matrices(*map(kind, dense), **given, **(exported | {"primaries": primaries}))
        np.testing.assert_array_equal(found.ambient, expected.ambient)
        np.testing.assert_array_equal(found.mask, expected.mask)
        np.testing.assert_array_equal(found.calibration.primaries, expected.calibration.primaries)
        np.testing.assert_array_equal(found.transport.to_csr().toarray(), expected.transport.to_csr().toarray())
    p = rng.random((9, 14, 3), np.float32)
    for values in (p, p.ravel()):
        seen = room.transport @ kind(values)
        assert type(seen) is np.ndarray
        np.testing.assert_array_equal(seen, room.transport @ values)
    np.testing.assert_array_equal(room.seen(kind(p)), room.seen(p))
    for picture in (CODES, rng.random((12, 16, 3))):
        found = cl.solve(room, kind(picture), "direct")
        np.testing.assert_array_equal(found.drive, cl.solve(room, picture, "direct").drive)


def test_a_tensor_elsewhere_is_refused_with_its_librarys_advice(room: cl.Room) -> None:
    elsewhere = OnGpu(np.ones((12, 16, 3)))
    for take in (lambda: cl.solve(room, elsewhere), lambda: room.transport.T @ elsewhere):
        with pytest.raises(
            TypeError, match=r"OnGpu is no array of numbers \(the tensor is on a GPU; copy it with .cpu"
        ):
            take()


def test_tensors_of_torch_are_taken(room: cl.Room) -> None:
    torch = pytest.importorskip("torch")
    p = torch.rand((9, 14, 3))
    np.testing.assert_array_equal(room.transport @ p, room.transport @ p.numpy())


@pytest.mark.parametrize("codes", [CODES, 257 * CODES.astype(np.uint16), (200 * CODES.astype(np.uint16)).astype(">u2")])
def test_integers_are_srgb_codes_as_play_takes_them(room: cl.Room, tmp_path: Path, codes: np.ndarray) -> None:
    write_png(tmp_path / "picture.png", codes.astype(codes.dtype.newbyteorder("=")))
    played = cl.read_picture(tmp_path / "picture.png", room)
    for given in (codes, np.asfortranarray(codes), Tensor(codes)):
        np.testing.assert_allclose(
            cl.solve(room, given, "direct").drive, cl.solve(room, played, "direct").drive, atol=5e-7
        )  # a file is read by the player's float32 pass
    maps = cl.build_maps(room, inverse="none")
    with cl.Renderer(room, maps, backend="cpu") as renderer:
        np.testing.assert_allclose(renderer.render(codes, refine=0), renderer.render(played, refine=0), atol=5e-7)
    drive = codes[:9, :14]
    np.testing.assert_allclose(room.seen(drive), room.seen(played[:9, :14]), atol=5e-7)


@pytest.mark.parametrize(
    "picture", [CODES.astype(int), CODES.astype(np.int8), CODES.astype(np.uint32), [[1, 0, 0]] * 3]
)
def test_other_integers_are_refused_with_the_fix(room: cl.Room, picture: object) -> None:
    for take in (lambda: cl.solve(room, picture), lambda: room.seen(picture)):
        with pytest.raises(
            InputError, match=r"of u?int\d+: expected sRGB code values as uint8 .*or linear light as floats"
        ):
            take()


def test_floats_stay_linear(room: cl.Room) -> None:
    linear = np.random.default_rng(4).random((12, 16, 3))
    expected = cl.solve(room, linear, "direct").drive
    for same in (linear.tolist(), linear.astype(np.longdouble), linear.astype(">f8"), Tensor(linear)):
        np.testing.assert_array_equal(cl.solve(room, same, "direct").drive, expected)
    for grey in (1, 1.0, np.ones(3), True):
        np.testing.assert_array_equal(
            cl.solve(room, grey, "direct").drive, cl.solve(room, np.ones((12, 16, 3)), "direct").drive
        )


def test_floats_that_look_like_codes_are_reported_by_a_warning(room: cl.Room) -> None:
    with pytest.warns(UserWarning, match="its median is .* times white; .* pass code values as uint8") as caught:
        cl.solve(room, CODES.astype(float), "direct")
    assert caught[0].filename == __file__
    cl.solve(room, CODES.astype(float), "direct", white=1.0)  # radiance
    with pytest.warns(UserWarning, match="drive: its median is .* pass code values as uint8") as caught:
        room.seen(np.full((*room.projector, 3), 200.0))
    assert caught[0].filename == __file__


@pytest.mark.parametrize(
    ("picture", "complaint"),
    [
        (np.ones((12, 16)), r"shape \(12, 16\), expected \(12, 16, 3\); repeat grey"),
        (np.ones((12, 16, 4)), r"shape \(12, 16, 4\), expected \(12, 16, 3\); leave the fourth channel out"),
        (np.ones((16, 12, 3)), "width and height are swapped"),
        (np.ones((3, 12, 16)), r"the channels come last, as in \w+\.transpose\(1, 2, 0\)"),
        (np.ones((3, 16, 12)), r"the channels come last, as in \w+\.transpose\(2, 1, 0\)"),
        (np.ones((16, 3)), r"shape \(16, 3\), expected"),  # numpy would broadcast this shape
        (np.zeros((0, 3)), r"shape \(0, 3\), expected"),
        (np.full((12, 16, 3), np.inf), "NaN or infinity"),
        (np.full((12, 16, 3), 1e300), r"holds 1e\+300, expected at most"),
        (np.ones((12, 16, 3), complex), "complex128 of shape"),
        (np.ones((12, 16, 3), object), "object of shape"),
        (np.zeros((12, 16, 3), "M8[s]"), "datetime64"),
        ("frame.png", "expected an array of real numbers"),
        (None, "expected an array of real numbers"),
        ([[1.0], [1.0, 2.0]], "list is no array of numbers"),
    ],
)
def test_what_is_no_picture_is_reported_everywhere(room: cl.Room, picture: object, complaint: str) -> None:
    maps = cl.build_maps(room, inverse="none", refine=False)
    with pytest.raises((InputError, TypeError), match=complaint):
        cl.solve(room, picture)
    with cl.Renderer(room, maps, backend="cpu") as renderer, pytest.raises((InputError, TypeError), match=complaint):
        renderer.render(picture)


def test_a_renderer_takes_what_it_knows(room: cl.Room, maps: RoomMaps) -> None:
    for backend in ("cuda", "CPU", "", None):
        with pytest.raises((InputError, TypeError), match=r"backend=.*: expected one of auto, gl, cpu"):
            cl.Renderer(room, maps, backend=backend)
    for white in (0, -1, np.nan, 1e30, "1", np.ones(3)):
        with pytest.raises((InputError, TypeError), match="white="):
            cl.Renderer(room, maps, backend="cpu", white=white)
    with pytest.raises(TypeError, match="dither"):
        cl.Renderer(room, maps, backend="cpu", dither="noise")
    renderer = cl.Renderer(room, maps, backend="cpu")
    for look in (renderer.camera_view, renderer.certificate):
        with pytest.raises(InputError, match="call render first"):
            look()
    for refine in (-1, 257, 1.5, "auto", True, np.nan):
        with pytest.raises((InputError, TypeError), match=r"refine=.*: expected (0 to 256|a whole number)"):
            renderer.render(0.5, refine=refine)
    renderer.close()
    for look in (lambda: renderer.render(0.5), renderer.camera_view, renderer.certificate):
        with pytest.raises(InputError, match="the renderer is closed"):
            look()


def test_maps_and_rooms_belong_together(room: cl.Room, maps: RoomMaps, tmp_path: Path) -> None:
    other = cl.simulate("wall", camera=(9, 16), projector=(9, 14))
    with pytest.raises(InputError, match=r"maps: for camera \(12, 16\) .*, the room has camera \(9, 16\)"):
        cl.Renderer(other, maps, backend="cpu")
    with pytest.raises(InputError, match=r"maps: for camera \(12, 16\)"):
        other.write(tmp_path / "room", maps=maps)
    assert list(tmp_path.iterdir()) == []
    for swapped in (lambda: cl.Renderer(maps, room), lambda: cl.solve(np.ones(3), room), lambda: cl.build_maps("room")):
        with pytest.raises(TypeError, match="room: expected Room, found"):
            swapped()
    few = cl.build_maps(room, inverse="none", refine=False)
    with cl.Renderer(room, few, backend="cpu") as renderer, pytest.raises(InputError, match=r"refine=4: .*refine=True"):
        renderer.render(0.5, refine=4)


@pytest.mark.parametrize(
    ("call", "complaint"),
    [
        (lambda room: cl.simulate("nosuch"), "nosuch: no such file, no shipped scene"),
        (lambda room: cl.simulate("corne"), "did you mean 'corner'"),
        (lambda room: cl.simulate(""), "scene is empty"),
        (lambda room: cl.simulate(None), "scene=None: expected a path"),
        (lambda room: cl.simulate("wall", without="shadows"), "without='shadows': expected a list of names"),
        (lambda room: cl.simulate("wall", without=3), "without=3: expected a list of names"),
        (lambda room: cl.simulate("wall", without=["shadow"]), "did you mean 'shadows'"),
        (lambda room: cl.simulate("wall", within=-1), "within=-1: expected at least 0"),
        (lambda room: cl.simulate("wall", within="0.1dB"), "within='0.1dB': expected a number"),
        (lambda room: cl.simulate("wall", tolerance=np.nan), "tolerance=nan: expected 0 to 10"),
        (lambda room: cl.simulate("wall", camera=(0, 3)), "camera height=0"),
        (lambda room: cl.build_maps(room, nonsense=1), r"build_maps\(\) got an unexpected keyword argument 'nonsense'"),
        (lambda room: cl.build_maps(room, damping=-1), "damping=-1: expected 0 to 1"),
        (lambda room: cl.build_maps(room, damping="auto"), "damping='auto': expected a number"),
        (lambda room: cl.build_maps(room, max_error=np.inf), "max_error=inf: expected 0 to 255"),
        (lambda room: cl.build_maps(room, max_cluster=1.5), "max_cluster=1.5: expected a whole number"),
        (lambda room: cl.build_maps(room, max_cluster=127), "max_cluster=127: expected 1 to 126"),
        (
            lambda room: cl.build_maps(room, max_cluster=9, inverse="whole"),
            "inverse whole: cuts nothing; leave max_c",
        ),
        (lambda room: cl.build_maps(room, noise=1), "noise 1.*: expected"),
        (lambda room: cl.build_maps(room, parameters=3), "parameters: expected Parameters, found int"),
        (lambda room: cl.build_maps(room, refine="no"), "refine: expected bool, found str"),
        (lambda room: cl.build_maps(room, colour="pixel"), "colour pixel: .*leave the argument out"),
        (lambda room: cl.solve(room, 0.5, None), "solver=None: expected one of"),
        (lambda room: cl.solve(room, 0.5, priors="yes"), "priors: expected bool, found str"),
        (lambda room: cl.solve(room, 0.5, ["box"]), "solver=.*: expected one of"),
        (lambda room: cl.read_room("nosuch"), "nosuch: no such folder"),
        (lambda room: cl.read_room("\0"), "contains a NUL character"),
        (lambda room: cl.read_maps(3), "folder=3: expected a path"),
        (lambda room: cl.read_picture("nosuch.png", room), "nosuch.png: no such file"),
        (lambda room: cl.read_picture("nosuch.png", (1 << 20, 1 << 20)), "where height=1048576: expected 1 to"),
        (lambda room: cl.read_picture("nosuch.png", 3), r"where=3: expected \(height, width\)"),
        (lambda room: room.write("/proc/room"), "/proc/room"),
        (lambda room: room.write(None), "folder=None: expected a path"),
        (
            lambda room: cl.Room(room.calibration, cl.simulate("wall", camera=(9, 9), projector=(8, 8)).parts),
            "is for",
        ),
        (lambda room: cl.Room(3, room.parts), "calibration: expected Calibration, found int"),
    ],
)
def test_errors_are_in_terms_of_the_call(room: cl.Room, call: Callable[[cl.Room], object], complaint: str) -> None:
    with pytest.raises((InputError, TypeError), match=complaint) as caught:
        call(room)
    assert not re.search(r"--|argparse|__init__|InverseOptions", str(caught.value))


def test_a_folder_that_is_there_is_replaced_with_force(room: cl.Room, tmp_path: Path) -> None:
    room.write(tmp_path / "room")
    with pytest.raises(InputError, match=r"choose another name or replace it with force=True"):
        room.write(tmp_path / "room")
    with pytest.raises(TypeError, match="force: expected bool, found int"):
        room.write(tmp_path / "room", force=1)
    room.write(tmp_path / "room", force=True)


def reached(thing: object, found: dict[int, object]) -> dict[int, object]:
    """Collect the dataclasses reachable from `thing` through fields, including itself."""
    for each in thing.values() if isinstance(thing, dict) else thing if isinstance(thing, tuple) else (thing,):
        if is_dataclass(each) and id(each) not in found:
            found[id(each)] = each
            for field in fields(each):
                reached(getattr(each, field.name), found)
    return found


def test_whatever_it_returns_is_one_line(room: cl.Room, maps: RoomMaps) -> None:
    dense = cl.simulate("corner", camera=(12, 16), projector=(9, 14))
    table = replace(room.calibration.projector, response=parse_response(np.linspace(0, 1, 500).tolist()))
    measured = cl.Room(replace(room.calibration, projectors=(table,)), room.parts)
    everything: dict[int, object] = {}
    for each in (room, maps, dense, measured, cl.build_maps(dense), cl.solve(room, 0.5, "direct"), room.tier):
        reached(each, everything)
    with cl.Renderer(room, maps, backend="cpu") as renderer:
        renderer.render(0.5)
        assert repr(renderer) == f"<Renderer 'cpu': camera (12, 16), projector (9, 14), white {maps.white:.4g}>"
        reached(renderer.certificate(), everything)
    names = {type(each).__name__ for each in everything.values()}
    assert names >= {
        "Room",
        "RoomMaps",
        "Transport",
        "Calibration",
        "RowMap",
        "SparseRows",
        "Chain",
        "Response",
        "Tier",
    }
    for each in everything.values():
        assert len(repr(each)) <= 400, type(each)
        assert "\n" not in repr(each), type(each)
    for each, *sizes in (
        (room, "(12, 16)", "(9, 14)"),
        (maps, "(12, 16)", "(9, 14)"),
        (room.transport, "(12, 16, 3)", "(9, 14, 3)"),
        (room.parts, "(192, 126)"),
    ):
        assert len(repr(each)) <= 200
        assert all(size in repr(each) for size in sizes)


def test_plots_show_rooms_maps_and_errors(room: cl.Room, maps: RoomMaps, tmp_path: Path) -> None:
    found = cl.solve(room, np.full((12, 16, 3), 0.5), "direct")
    np.testing.assert_allclose(found.error, (found.seen - 0.5 * room.white) / room.white, atol=1e-12)
    drawn = {each: each.plot() for each in (room, found)} | {repr(maps): maps.plot()}
    for number, figure in enumerate(drawn.values()):
        figure.savefig(tmp_path / f"{number}.png")
        assert cv2.imread(str(tmp_path / f"{number}.png")).std() > 10
        assert figure._repr_png_().startswith(b"\x89PNG")
    titles = {axes.get_title(): axes.images[0] for figure in drawn.values() for axes in figure.axes if axes.get_title()}
    error = 100 * (found.error @ [0.2126, 0.7152, 0.0722])
    np.testing.assert_allclose(titles["error of luminance, % of white"].get_array(), error, atol=1e-9)
    low, high = titles["error of luminance, % of white"].get_clim()
    assert low == -high
    lengths = titles["entries of near light per camera pixel"].get_array()
    assert lengths.sum() == room.parts.near.indices.size
    np.testing.assert_array_equal(titles["entries of T per camera pixel"].get_array(), lengths)
    assert titles["full light"].get_array().shape == (12, 16, 3)
    shown = titles["target, 2 times as bright"].get_array()  # the target is half of white
    np.testing.assert_allclose(shown, 1, atol=1e-9)
    assert "camera (12, 16)" in figure.get_suptitle()


def test_plots_without_matplotlib_are_refused(room: cl.Room, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(InputError, match=r"matplotlib, which is not installed; .* 'counterlight\[study\]'"):
        room.plot()


def test_the_namespace_is_the_api() -> None:
    public = ["InputError", "Renderer", "Room", "Solution", "build_maps", "read_maps", "read_picture", "read_room"]
    assert dir(cl) == sorted(cl.__all__) == sorted([*public, "simulate", "solve", "__version__"])
    assert cl.__version__ == version("counterlight")
    assert cl.InputError is InputError
    assert all(hasattr(cl, name) for name in dir(cl))
    assert not hasattr(cl, "Any")
    assert "numpy._typing" not in pydoc.plain(pydoc.render_doc(cl))  # names of types, not what they stand for


def test_wrong_pictures_and_names_are_reported(room: cl.Room) -> None:
    with pytest.raises(InputError, match=r"shape \(9, 14, 3\), expected \(12, 16, 3\)"):
        cl.solve(room, np.ones((9, 14, 3)))
    with pytest.raises(InputError, match="did you mean 'nnls'"):
        cl.solve(room, np.ones(3), "nnsl")
    with pytest.raises(InputError, match="did you mean 'whole'"):
        cl.build_maps(room, inverse="hwole")


def test_importing_is_free() -> None:
    code = "import sys, counterlight; print(*sorted(set(sys.modules) & {'numpy', 'scipy', 'moderngl', 'cv2', 'numba'}))"
    assert python("-c", code).split() == []
    code = "import sys, counterlight; counterlight.Room; print(*(set(sys.modules) & {'moderngl', 'scipy.optimize'}))"
    assert python("-c", code).split() == []

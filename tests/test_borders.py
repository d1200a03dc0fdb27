"""Hostile room files: impossible values, one at a time and by the hundred; existing files stay unchanged."""

import os
import re
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from scipy import sparse

from counterlight import calibration
from counterlight.calibration import Calibration, Device
from counterlight.errors import InputError
from counterlight.files import exr
from counterlight.files.reading import read_toml
from counterlight.maps.room_maps import FOLDER, MANIFEST, read_maps
from counterlight.maps.row_map import SparseRows, pack
from counterlight.pipeline.placement import FILE as PLACEMENT
from counterlight.pipeline.placement import write_placement
from counterlight.response import Response
from counterlight.tools import acquire_transport, compensate_image, join_projectors, relight
from counterlight.tools.inverse.build import build_room_maps
from counterlight.tools.inverse.far_light import undo_far_light
from counterlight.tools.inverse.near_light import InverseOptions
from counterlight.tools.transport.storage import write_transport
from counterlight.tools.transport.transport import Transport, far_light_of, stacked
from tests.hostile import little_memory, without_rights
from tests.mutants import READ, REFUSED, DamagedRoom, mutant
from tests.programs import fail
from tests.rooms import write_blurred_room
from tests.samples import samples

MANIFEST_NAME = f"{FOLDER}/{MANIFEST}"
CAMERA, PROJECTOR, CELLS = (13, 18), (10, 14), 4
MIXING = np.array([[0.88, 0.08, 0.04], [0.06, 0.88, 0.06], [0.03, 0.09, 0.88]])
WIDE = '{ width = 16384, height = 16384, response = "srgb" }'


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Room with far light, a mixing per pixel, maps and a placement."""
    folder = tmp_path_factory.mktemp("built") / "room"
    write_blurred_room(folder, np.random.default_rng(1), CAMERA, PROJECTOR, CELLS, MIXING)
    build_room_maps(calibration.read(folder), InverseOptions(), colour="pixel")
    write_placement(folder, ((0.1, 0.2), (0.9, 0.1), (1.05, 0.9), (-0.02, 0.8)))
    return folder


@pytest.fixture
def room(built: Path, tmp_path: Path) -> DamagedRoom:
    shutil.copytree(built, tmp_path / "room")
    return DamagedRoom.of(tmp_path / "room")


# One at a time


@pytest.mark.parametrize(
    ("name", "old", "new", "complaint"),
    [
        ("calibration.toml", "format = 1", "format = true", "format True, this version reads 1"),
        ("calibration.toml", "format = 1", "format = 1.0", "format 1.0, this version reads 1"),
        ("calibration.toml", 'response = "srgb"', "response = true", "response True: expected linear, srgb"),
        ("calibration.toml", 'response = "srgb"', f"response = 1{'0' * 400}", "an integer of more than 64 bits"),
        ("calibration.toml", 'response = "srgb"', "response = 1e400", "gamma inf, expected 0.1 to 10"),
        ("calibration.toml", 'response = "srgb"', "response = [0, true]", "a table holds numbers"),
        ("calibration.toml", 'response = "srgb"', "response = {}", "response {}: expected linear"),
        ("calibration.toml", "width = 14", "width = true", "width: found True, expected a whole number from 1"),
        ("calibration.toml", "width = 14", "width = -14", "width: found -14, expected a whole number from 1"),
        ("calibration.toml", 'name = "blurred wall"', "name = 7", "name: found 7, expected a text"),
        ("calibration.toml", 'name = "blurred wall"', f'name = "{"x" * 2000}"', "name: found 'x{79}…, expected a text"),
        ("calibration.toml", "projectors = [", f"projectors = [{'{ width = 9, height = 9 },' * 64}", "needs one to 64"),
        ("calibration.toml", "projectors = [", f"projectors = [{WIDE},", "size 16384x32768: expected 1 to 16384"),
        (MANIFEST_NAME, "format = 2", "format = true", "format True, this version reads 2"),
        (MANIFEST_NAME, "white = ", "white = 5e-324 # ", "white: found 5e-324, expected a number"),
        (MANIFEST_NAME, "white = ", "white = 1e300 # ", "number from 1e-12 to 1e.12"),
        (MANIFEST_NAME, "white = ", "white = true # ", "white: found True, expected a number"),
        (MANIFEST_NAME, "white = ", "white = nan # ", "white: found nan, expected a number"),
        (MANIFEST_NAME, "wide_index = false", "wide_index = 0", "wide_index: found 0, expected true or false"),
        (MANIFEST_NAME, "[maps.direct]", "[maps.dirct]", r"\[maps\]: needs direct; is 'dirct' meant to be it"),
        (PLACEMENT, "format = 1", "format = true", "format True, this version reads 1"),
        (PLACEMENT, "0.1,", "1e300,", "corners: found 1e.300|2 numbers from -2 to 3"),
    ],
)
def test_a_value_that_no_room_has(room: DamagedRoom, name: str, old: str, new: str, complaint: str) -> None:
    text = room.files[name].decode()
    assert old in text
    room.put(name, text.replace(old, new, 1).encode())
    with pytest.raises(InputError, match=rf"{Path(name).name}.*{complaint}"):
        room.read()


def with_numbers(room: DamagedRoom, name: str, change: Callable[[Path], object]) -> None:
    """Change a file and renew the checksums."""
    change(room.folder / name)
    room.put(name, (room.folder / name).read_bytes())


def picture(value: float) -> Callable[[Path], object]:
    def change(path: Path) -> None:
        ambient = exr.read_rgb(path)
        ambient[3, 4, 1] = value
        exr.write_rgb(path, ambient)

    return change


@pytest.mark.parametrize("value", [-1e30, -0.5, np.nan, np.inf, 1e13])
def test_ambient_light_that_is_none(room: DamagedRoom, value: float) -> None:
    with_numbers(room, "ambient.exr", picture(value))
    with pytest.raises(InputError, match=r"ambient\.exr: radiance from .* to .*, expected numbers from 0"):
        room.read()


def test_noise_below_zero_is_ambient_light(room: DamagedRoom) -> None:
    with_numbers(room, "ambient.exr", picture(-1e-4))
    room.read()


def arrays(**changes: object) -> Callable[[Path], object]:
    """Returns a function that changes arrays of an archive; a callable value computes the array from the old array."""

    def change(path: Path) -> None:
        with np.load(path) as stored:
            parts = dict(stored)
        for name, value in changes.items():
            parts[name] = value(parts[name]) if callable(value) else np.asarray(value)  # type: ignore[assignment]
        np.savez_compressed(path, **parts)  # type: ignore[arg-type]

    return change


def first(value: float) -> Callable[[np.ndarray], np.ndarray]:
    def change(values: np.ndarray) -> np.ndarray:
        values = values.copy()
        values.flat[0] = value
        return values

    return change


NO_FAR_LIGHT = {
    "NaN in M": (arrays(mix=first(np.nan)), "1 of 48 entries are NaN or infinite"),
    "infinity in U": (arrays(scatter_red_data=first(np.inf)), "1 of 234 entries are NaN or infinite"),
    "NaN in D": (arrays(gather_blue_data=first(np.nan)), "1 of 140 entries are NaN or infinite"),
    "M of 1e30": (arrays(mix=lambda mix: mix * np.float32(1e30)), r"an entry of \d.*e\+2\d, expected at most 1e\+12"),
    "a product": (
        arrays(mix=lambda mix: mix * 1e9, scatter_green_data=lambda data: data * 1e9),
        r"its factors' product: an entry of \d.*e\+1\d, expected at most 1e\+12",
    ),
    "infinite cells": (arrays(cells=np.inf), "float64 of shape .., expected whole numbers, a single value"),
    "no cells": (arrays(cells=0), "0 cells, expected 1 to 32768"),
    "other cells": (arrays(cells=5), "float32 of shape .3, 4, 4., expected real numbers, 3x5x5"),
    "more cells than there can be": (arrays(cells=2**62), "4611686018427387904 cells, expected 1 to 32768"),
    "complex": (arrays(mix=lambda mix: mix.astype(complex)), "complex128 of shape .3, 4, 4., expected real numbers"),
    "text": (arrays(mix=lambda mix: mix.astype(str)), "<U32 of shape .3, 4, 4., expected real numbers"),
    "another shape": (arrays(mix=lambda mix: mix[:2]), "float32 of shape .2, 4, 4., expected real numbers, 3x4x4"),
    "an index": (arrays(gather_red_indices=lambda i: i + 9999), "not the far light of this calibration"),
}


@pytest.mark.parametrize("kind", NO_FAR_LIGHT)
def test_far_light_that_is_none_is_refused_and_the_maps_stay(room: DamagedRoom, kind: str) -> None:
    change, complaint = NO_FAR_LIGHT[kind]
    before = {path: path.read_bytes() for path in sorted((room.folder / FOLDER).rglob("*.exr"))}
    with_numbers(room, "far_light.npz", change)
    with pytest.raises(InputError, match=rf"far_light\.npz: .*{complaint}"):
        build_room_maps(calibration.read(room.folder), InverseOptions())
    assert {path: path.read_bytes() for path in sorted((room.folder / FOLDER).rglob("*.exr"))} == before


def test_commands_say_so_in_one_line(
    room: DamagedRoom, built: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with_numbers(room, "far_light.npz", arrays(mix=first(np.nan)))
    out, card = str(tmp_path / "out"), tmp_path / "card.exr"
    exr.write_rgb(card, np.full((*CAMERA, 3), 0.3, np.float32))
    words = str(room.folder)
    commands: tuple[tuple[Callable[[list[str]], int], list[str]], ...] = (
        (relight.main, [words, "-o", f"{out}.png"]),
        (compensate_image.main, [words, str(card), "--solver", "direct", "-o", f"{out}.png"]),
        (join_projectors.main, [str(built), words, "-o", out]),
        (acquire_transport.main, ["--camera", f"simulated:{words}", "-o", out]),
    )
    for complaint in ("far_light.npz: 1 of 48 entries are NaN or infinite", "ambient.exr: a pipe, expected a regular"):
        assert complaint in fail("build", words)
        for command, arguments in commands:
            assert command(arguments) == 2
            line = capsys.readouterr().err
            assert line.startswith("error: ")
            assert complaint in line
            assert line.count("\n") == 1
        (room.folder / "ambient.exr").unlink(missing_ok=True)
        os.mkfifo(room.folder / "ambient.exr")
    assert complaint in fail("play", words, card, "--output", f"{out}.png")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["card.exr", "room"]


def test_far_light_that_cannot_be_undone() -> None:
    """Far light with 1 + M D S⁺ U = 0, so that the inverse does not exist: as much light returns as is shown."""
    one = sparse.csr_array([[1.0]])
    for mix, complaint in ((-1.0, "singular"), (1e300, "times it")):
        scatter = sparse.csr_array([[1e-300 if mix > 0 else 1.0]])
        far = far_light_of((one,) * 3, np.full((3, 1, 1), mix), (scatter,) * 3)
        with pytest.raises(InputError, match=complaint):
            undo_far_light(far, stacked((one,) * 3))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_map_that_is_not_finite_is_not_packed(value: float) -> None:
    weights = np.ones((5, 3), np.float32)
    weights[3, 1] = value
    rows = SparseRows(np.array([0, 2, 2, 3, 5]), np.arange(5), weights, 5)
    with pytest.raises(InputError, match=r"the row of output pixel \(1, 1\) holds NaN or infinity, or a weight beyond"):
        pack(rows, (2, 2), (1, 5))


def write_room_in_unit(folder: Path, unit: float) -> None:
    T = sparse.csr_array(sparse.diags_array(np.full(20, unit))).astype(np.float32)
    device = Device(4, 5, Response("linear"))
    dark = Calibration("unit", "a test", (device,), device, np.zeros((4, 5, 3), np.float32), np.ones((4, 5), bool))
    with calibration.writing(folder, dark) as stage:
        write_transport(Transport.from_matrices((T, T, T)), stage)


def test_light_in_no_unit_is_refused(tmp_path: Path) -> None:
    """A room that is too bright is not written. No map is built for a room that is so dark that white is almost 0."""
    with pytest.raises(InputError, match=r"transport of the red channel: an entry of 1e\+13, expected at most 1e\+12"):
        write_room_in_unit(tmp_path / "bright", 1e13)
    write_room_in_unit(tmp_path / "dark", 1e-14)
    with pytest.raises(InputError, match=r"white is a camera radiance of 1e-14, expected 1e-12 to 1e\+12"):
        build_room_maps(calibration.read(tmp_path / "dark"), InverseOptions())
    assert [path.name for path in tmp_path.iterdir()] == ["dark"]
    assert not (tmp_path / "dark" / FOLDER).exists()


def test_a_map_outside_the_room_is_not_opened(room: DamagedRoom, tmp_path: Path) -> None:
    """The product names a manifest's maps; maps with other names are ignored."""
    os.mkfifo(tmp_path / "lookup.exr")
    manifest = read_toml(room.folder / MANIFEST_NAME, "")
    for name in (str(tmp_path), "../..", "dual/../../.."):
        manifest["maps"][name] = manifest["maps"]["dual"]
        manifest["files"][f"{name}/lookup.exr"] = {"bytes": 0, "sha256": ""}
    (room.folder / MANIFEST_NAME).write_text(tomli_w.dumps(manifest))
    assert set(read_maps(calibration.read(room.folder)).named()) == set(manifest["maps"]) - {
        str(tmp_path),
        "../..",
        "dual/../../..",
    }


def test_maps_that_do_not_fit_are_refused_by_the_manifest(room: DamagedRoom) -> None:
    """Maps that claim 16384x16384 pixels, which would need gigabytes, are refused before their files are opened."""
    for name, key in (("transport", "output"), ("far_gather", "output"), ("dual_scatter", "source"), (".", "output")):
        manifest = read_toml(room.folder / MANIFEST_NAME, "")
        manifest["maps"][name][key] = [16384, 16384]
        (room.folder / MANIFEST_NAME).write_text(tomli_w.dumps(manifest))
        with pytest.raises(InputError, match=rf"maps.: .{re.escape(name)}.: a map from .*16384"), little_memory():
            room.read()
        (room.folder / MANIFEST_NAME).write_bytes(room.files[MANIFEST_NAME])


def test_rows_that_share_texels_are_refused(room: DamagedRoom) -> None:
    """Each row has a valid place, but unpacking all rows would need unlimited memory."""

    def change(path: Path) -> None:
        channels = exr.read_channels(path)
        width = int(read_toml(room.folder / MANIFEST_NAME, "")["maps"]["transport"]["texture"][0])
        exr.write_channels(path, {"X": 0 * channels["X"], "Y": channels["Y"], "LENGTH": 0 * channels["Y"] + width})

    with_numbers(room, f"{FOLDER}/transport/lookup.exr", change)
    with pytest.raises(InputError, match=r"transport: rows of \d+ entries in \d+x\d+ texels, so they overlap"):
        room.read()


@pytest.mark.parametrize("name", ["calibration.toml", "ambient.exr", "mask.png", "transport_red.npz", "far_light.npz"])
def test_what_may_not_be_read_need_not_be_made_again(built: Path, name: str) -> None:
    with tempfile.TemporaryDirectory() as above:  # a user without rights may enter this folder, unlike tmp_path
        folder = Path(shutil.copytree(built, Path(above) / "room"))
        for path in (Path(above), folder, *folder.rglob("*")):
            path.chmod(0o755)
        (folder / name).chmod(0)
        with without_rights(), pytest.raises(InputError, match=rf"{name}: permission denied") as caught:
            DamagedRoom(folder, {}).read()
        assert "again" not in str(caught.value)


@pytest.mark.parametrize("name", ["calibration.toml", "ambient.exr", "mask.png", "transport_red.npz", PLACEMENT])
def test_what_is_no_file_is_refused_at_once(room: DamagedRoom, name: str) -> None:
    (room.folder / name).unlink()
    os.mkfifo(room.folder / name)
    with pytest.raises(InputError, match=rf"{name}: a pipe, expected a regular file"):
        room.read()


# By the hundred


@pytest.mark.parametrize("suffix", [".toml", ".npz", ".exr", ".png"])
def test_a_damaged_room_is_read_or_refused(room: DamagedRoom, suffix: str) -> None:
    """Each kind of file has 80 mutants. 60 have renewed checksums; the other 20 are refused unless they are TOML."""
    names = [name for name in room.files if name.endswith(suffix)]
    found = set()
    for i in range(80):
        rng = np.random.default_rng([20060504, i])
        name = names[rng.integers(len(names))]
        content, renewed = mutant(room.files[name], name, rng), i < 60
        with little_memory():
            outcome = room.outcome(name, content, renewed=renewed)
        found.add(outcome)
        if not renewed and suffix != ".toml" and content != room.files[name]:
            assert outcome == REFUSED, (i, name)
    assert found == {READ, REFUSED}  # otherwise the mutants are too mild or too harsh
    room.read()


def test_every_other_damaged_file_is_read_or_refused(tmp_path: Path) -> None:
    """Twelve mutants each of settings, responses, scenes, sessions, meshes, tables, arrays and pictures."""
    (tmp_path / "made").mkdir()
    files = samples(tmp_path / "made")
    found = []
    for number, (name, sample) in enumerate(files.items()):
        assert sample.outcome(tmp_path / name, sample.content) == READ, name
        for i in range(12):
            content = mutant(sample.content, name, np.random.default_rng([number, i]))
            with little_memory():
                found.append(sample.outcome(tmp_path / name, content))
    assert 0.05 < found.count(READ) / len(found) < 0.5  # otherwise the mutants are too harsh or too mild

"""counterlight export: readers that share no code with the writer, and an independent judge of the warp."""

import io
import re
import zipfile
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import OpenEXR
import PyOpenColorIO
import pytest
from PIL import Image
from scipy import sparse

import counterlight as cl
from counterlight.calibration import Calibration, Device
from counterlight.response import Response
from counterlight.screen import Screen
from counterlight.tools.exports.diagonal import diagonal
from counterlight.tools.exports.files import ocio_config, write_cube
from counterlight.tools.transport.transport import Transport
from tests.programs import fail, succeed

CAMERA, PROJECTOR = (30, 40), (60, 88)  # the projector is finer than the bricks of the wall


def read_pfm(data: bytes) -> np.ndarray:
    """Returns (height, width, 3), rows as stored."""
    kind, size, scale, values = data.split(b"\n", 3)
    assert kind == b"PF"
    assert float(scale) < 0  # a negative scale means little-endian
    width, height = map(int, size.split())
    return np.frombuffer(values, "<f4").reshape(height, width, 3)


def read_mpcdi(path: Path) -> list[dict[str, np.ndarray]]:
    """Returns warp (rows from the top, v from the bottom), alpha and beta (linear) of each region."""
    archive = zipfile.ZipFile(path)
    root = ElementTree.fromstring(archive.read("mpcdi.xml"))
    assert (root.tag, root.get("version"), root.get("profile")) == ("MPCDI", "2.0", "2d")
    found = []
    for region in root.findall("display/buffer/region"):
        assert [float(region.get(name)) for name in ("x", "y", "xSize", "ySize")] == [0, 0, 1, 1]
        files = root.find(f"files/fileset[@region='{region.get('id')}']")
        assert files.findtext("geometryWarpFile/interpolation") == "linear"
        maps = {"warp": read_pfm(archive.read(files.findtext("geometryWarpFile/path")))}
        for name in ("alpha", "beta"):
            assert files.findtext(f"{name}Map/bitDepth") == "8"
            codes = np.asarray(Image.open(io.BytesIO(archive.read(files.findtext(f"{name}Map/path")))))
            maps[name] = (codes / 255) ** float(files.findtext(f"{name}Map/gammaEmbedded"))
        size = int(region.get("yResolution")), int(region.get("xResolution"))
        assert {each.shape for each in maps.values()} == {(*size, 3)}
        found.append(maps)
    return found


def sampled(picture: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Bilinear samples of a picture at u from the left and v from the bottom, 0 to 1."""
    height, width = picture.shape[:2]
    x, y = np.clip(u * width - 0.5, 0, width - 1), np.clip((1 - v) * height - 0.5, 0, height - 1)
    left, top = np.minimum(x.astype(int), width - 2), np.minimum(y.astype(int), height - 2)
    a, b = (x - left)[..., None], (y - top)[..., None]
    rows = [(1 - a) * picture[top + d, left] + a * picture[top + d, left + 1] for d in (0, 1)]
    return (1 - b) * rows[0] + b * rows[1]


def shown(maps: dict[str, np.ndarray], picture: np.ndarray) -> np.ndarray:
    """The drive of a program that reads MPCDI: the picture warped, times alpha, lifted by beta."""
    media = sampled(picture, maps["warp"][..., 0], maps["warp"][..., 1])
    return media * maps["alpha"] * (1 - maps["beta"]) + maps["beta"]


def soft(height: int, width: int) -> np.ndarray:
    """A picture without symmetry."""
    y, x = np.mgrid[:height, :width]
    grey = 0.3 + 0.2 * x / width + 0.1 * np.sin(y / 5) + 0.15 * ((x - 0.3 * width) ** 2 + (y - 0.6 * height) ** 2 < 60)
    return np.stack([grey, 0.9 * grey, 0.8 * grey], axis=-1)


def decibels(error: np.ndarray) -> float:
    return float(-20 * np.log10(np.sqrt(np.mean(error**2))))


@pytest.fixture(scope="module")
def wall(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wall") / "room"
    cl.simulate("wall", camera=CAMERA, projector=PROJECTOR).write(folder)
    return folder


def test_the_warp_puts_the_picture_where_t_says(wall: Path, tmp_path: Path) -> None:
    said = succeed("export", wall, "--mpcdi", tmp_path / "out.mpcdi", "--warp", tmp_path / "out.exr")
    room, picture = cl.read_room(wall), soft(*CAMERA)
    T = room.transport.to_csr()
    (maps,) = read_mpcdi(tmp_path / "out.mpcdi")
    black = np.percentile(room.ambient[room.mask], 99, axis=0)
    inside = room.mask.copy()
    inside[[0, 1, -2, -1]] = inside[:, [0, 1, -2, -1]] = False  # light from the edge of the wall is left out

    def quality(drive: np.ndarray) -> float:
        seen = (T @ drive.ravel()).reshape(*CAMERA, 3) + room.ambient
        target = black + (room.white - black) * picture
        return decibels((seen - target)[inside] / room.white)

    def at(right: float, down: float) -> float:
        """The quality if all places move by camera pixels."""
        warp = maps["warp"] + np.array([right / CAMERA[1], -down / CAMERA[0], 0])
        return quality(shown({**maps, "warp": warp}, picture))

    assert at(0, 0) > 37  # in dB; measured: 39.2
    assert max(at(0.25, 0), at(-0.25, 0), at(0, 0.25), at(0, -0.25)) < at(0, 0) - 0.5  # loss in dB; measured: 1.2
    flipped = {**maps, "warp": maps["warp"][::-1]}
    assert quality(shown(flipped, picture)) < 25
    lost = re.search(r"([\d.]+) dB with this warp, ([\d.]+) dB with the best drive; ([\d.]+) dB are lost", said)
    assert lost
    warped, best, difference = map(float, lost.groups())
    assert 20 < warped < best
    assert difference == pytest.approx(best - warped, abs=0.11)

    channels = OpenEXR.File(str(tmp_path / "out.exr"), separate_channels=True).channels()
    for name, expected in zip("RG", np.moveaxis(maps["warp"], -1, 0), strict=False):
        np.testing.assert_array_equal(channels[name].pixels, expected)
    np.testing.assert_array_equal(channels["A"].pixels > 0, maps["alpha"].max(axis=2) > 0)
    np.testing.assert_allclose(channels["alpha.G"].pixels, maps["alpha"][..., 1], atol=0.005)  # rounding to 8 bits


def test_bounces_and_paint_do_not_move_the_places(tmp_path: Path) -> None:
    """Each projector pixel lights two adjacent camera pixels, one of which is dark, and some light bounces."""
    rng = np.random.default_rng(4)
    height, width = 9, 14
    pixels = height * width
    rows, columns = np.arange(2 * pixels), np.repeat(np.arange(pixels), 2)
    direct = sparse.csr_array((np.ones(2 * pixels), (rows, columns)))
    bounces = sparse.random_array(direct.shape, density=0.02, rng=rng, format="csr") * 0.03
    paint = np.where(rows % 2 == 0, 0.9, 0.3)
    for T, tolerance in ((sparse.diags_array(paint) @ direct, 1e-6), (direct + bounces, 0.1)):
        room = cl.Room.from_matrices(
            T, T, T, camera=(height, 2 * width), projector=(height, width), response="linear", factor=0
        )
        room.write(tmp_path / "room", force=True)
        succeed("export", tmp_path / "room", "--mpcdi", tmp_path / "out.mpcdi")
        (maps,) = read_mpcdi(tmp_path / "out.mpcdi")
        y, x = np.mgrid[:height, :width]
        np.testing.assert_allclose(maps["warp"][..., 0], (x + 0.5) / width, atol=tolerance / width)
        np.testing.assert_allclose(maps["warp"][..., 1], 1 - (y + 0.5) / height, atol=tolerance / height)
        (tmp_path / "out.mpcdi").unlink()


def test_cameras_that_share_a_screen_agree_on_the_places() -> None:
    """Two cameras see the same wall, the second one in a mirror."""
    height, width = 6, 8
    y, x = np.mgrid[:height, :width]
    direct = (y * width + x).ravel()
    mirrored = (y * width + width - 1 - x).ravel()
    lit = np.concatenate([direct, mirrored])
    T = sparse.csr_array((np.ones(lit.size), (np.arange(lit.size), lit)))
    positions = np.concatenate([np.stack([x, y], axis=-1), np.stack([width - 1 - x, y], axis=-1)]) + 0.5
    screen = Screen((height, width), ((height, width),) * 2, positions.astype(np.float32))
    projector, raster = (Device(*shape, Response("linear")) for shape in ((height, width), (2 * height, width)))
    dark = np.zeros((*raster.shape, 3), np.float32)
    calibration = Calibration("two", "made by a test", (projector,), raster, dark, np.ones(raster.shape, bool))
    parts = Transport.from_matrices([T] * 3, camera=raster.shape, projector=projector.shape)
    kept = diagonal(cl.Room(replace(calibration, screen=screen), parts))
    assert kept.target == (height, width)
    np.testing.assert_allclose(kept.places * (width, height), np.stack([x, y], axis=-1) + 0.5, atol=1e-6)
    picture = soft(height, width)
    np.testing.assert_allclose(kept.drive(picture), picture, atol=1e-5)  # the room's white is 1


def test_projectors_blend_and_blacks_meet(tmp_path: Path) -> None:
    """Two projectors light one wall and overlap in the middle, where black is brighter."""
    height, width = 8, 12
    lit = np.arange(width) < 8, np.arange(width) >= 4
    T = np.zeros((height, width, height, 2 * width))
    for number, columns in enumerate(lit):
        for y, x in np.argwhere(np.broadcast_to(columns, (height, width))):
            T[y, x, y, x + number * width] = 1
    T = sparse.csr_array(T.reshape(height * width, -1))
    black = np.repeat(0.01 * np.sum(lit, axis=0)[None, :, None], height, axis=0).repeat(3, axis=2).astype(np.float32)
    linear = Device(height, width, Response("linear"))
    calibration = Calibration("two", "made by a test", (linear, linear), linear, black, np.ones((height, width), bool))
    parts = Transport.from_matrices([T] * 3, camera=(height, width), projector=(height, 2 * width))
    room = cl.Room(calibration, parts)
    room.write(tmp_path / "room")
    said = succeed("export", tmp_path / "room", "--mpcdi", tmp_path / "out.mpcdi", "--cube", tmp_path / "out.cube")
    assert f"{tmp_path / 'out_1.cube'} and {tmp_path / 'out_2.cube'}: written" in said.splitlines()[-1]
    found = read_mpcdi(tmp_path / "out.mpcdi")
    for grey in (0.0, 0.5, 1.0):
        picture = np.full((8, 12, 3), grey)
        drives = np.concatenate([shown(maps, picture) for maps in found], axis=1)
        seen = (T @ drives.reshape(-1, 3)).reshape(height, width, 3) + black
        np.testing.assert_allclose(seen, 0.02 + (room.white - 0.02) * grey, atol=0.01)  # alpha and beta have 8 bits
    assert {path.name for path in tmp_path.glob("out*")} == {"out.mpcdi", "out_1.cube", "out_2.cube", "out.ocio"}


def test_the_colour_table_gives_a_projectors_codes(wall: Path, tmp_path: Path) -> None:
    room = cl.read_room(wall)
    gamma, D = 2.4, ((0.8, 0.1, 0.1), (0.0, 0.9, 0.1), (0.1, 0.0, 0.9))
    T = room.transport.channel(1).to_csr()
    own = cl.Room.from_matrices(T, T, T, camera=CAMERA, projector=PROJECTOR, response=gamma)
    projector = replace(own.calibration.projectors[0], colour=D)
    cl.Room(replace(own.calibration, projectors=(projector,)), own.parts).write(tmp_path / "room")
    assert "out.ocio" in succeed("export", tmp_path / "room", "--cube", tmp_path / "out.cube")
    assert '"out.cube"' in (tmp_path / "out.ocio").read_text()
    lines = (tmp_path / "out.cube").read_text().splitlines()
    size = int(next(line for line in lines if line.startswith("LUT_3D_SIZE")).split()[1])
    table = np.array([line.split() for line in lines if line[0] in "01"], float).reshape(size, size, size, 3)
    red, green, blue = 3, 20, 32
    codes = np.array([red, green, blue]) / (size - 1)
    light = np.where(codes <= 0.04045, codes / 12.92, ((codes + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(table[blue, green, red], (np.array(D) @ light) ** (1 / gamma), atol=1e-3)


def test_opencolorio_applies_the_table(tmp_path: Path) -> None:
    write_cube(tmp_path / "out.cube", Device(9, 9, Response("gamma", 2.4)))
    (tmp_path / "out.ocio").write_text(ocio_config(["out.cube"]))
    config = PyOpenColorIO.Config.CreateFromFile(str(tmp_path / "out.ocio"))
    config.validate()
    processor = config.getProcessor("linear", "projector 1").getDefaultCPUProcessor()
    light = np.array([0.02, 0.3, 1.0])
    np.testing.assert_allclose(processor.applyRGB(light.tolist()), light ** (1 / 2.4), atol=1e-3)


def test_what_cannot_be_exported_is_refused(wall: Path, tmp_path: Path) -> None:
    assert "nothing to write; name a file with --mpcdi, --warp, --cube" in fail("export", wall)
    assert "use .mpcdi" in fail("export", wall, "--mpcdi", tmp_path / "out.zip")
    assert "no such folder" in fail("export", tmp_path / "nosuch", "--cube", tmp_path / "out.cube")
    assert "no such folder" in fail("export", wall, "--warp", tmp_path / "nosuch" / "out.exr")
    assert list(tmp_path.iterdir()) == []


def test_the_st_map_is_exact_also_next_to_an_mpcdi_file(wall: Path, tmp_path: Path) -> None:
    succeed("export", wall, "--warp", tmp_path / "alone.exr")
    succeed("export", wall, "--mpcdi", tmp_path / "out.mpcdi", "--warp", tmp_path / "both.exr")
    assert (tmp_path / "alone.exr").read_bytes() == (tmp_path / "both.exr").read_bytes()


def test_an_output_that_cannot_be_written_leaves_no_file(wall: Path, tmp_path: Path) -> None:
    (tmp_path / "out.ocio").mkdir()
    assert "name a file" in fail("export", wall, "--mpcdi", tmp_path / "out.mpcdi", "--cube", tmp_path / "out.cube")
    assert [path.name for path in tmp_path.iterdir()] == ["out.ocio"]

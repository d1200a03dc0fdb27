"""OpenEXR files: exact in several kinds; false headers are refused before the library decodes anything."""

import struct
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from counterlight import memory
from counterlight.errors import InputError
from counterlight.files import exr, exr_lines
from counterlight.media.decoding.media import open_source
from counterlight.media.medium import Medium
from tests.hostile import little_memory

HOSTILE = Path(__file__).resolve().parents[1].parent / "shared" / "data" / "hostile"
UINT, HALF, FLOAT = 0, 1, 2
ZIP, DEEP, TILED, MULTIPART = 3, 0x800, 0x200, 0x1000


def test_exr_pictures_are_exact(tmp_path: Path, rng: np.random.Generator) -> None:
    picture = rng.normal(size=(5, 9, 3)).astype(np.float32)
    exr.write_rgb(tmp_path / "p.exr", picture[:, ::-1][:, ::-1])
    assert exr.read_rgb(tmp_path / "p.exr").tobytes() == picture.tobytes()
    exr.write_channels(tmp_path / "z.exr", {"Z": picture[..., 0]})
    with pytest.raises(InputError, match=r"channels \('Z',\), expected R, G and B"):
        exr.read_rgb(tmp_path / "z.exr")
    with pytest.raises(InputError, match=r"p\.exr: 9x5, the camera is 5x9; take another"):
        exr.read_rgb(tmp_path / "p.exr", exr.sized((9, 5), "the camera", "take another"))


def test_windows_are_honoured(tmp_path: Path, rng: np.random.Generator) -> None:
    """Data of 4x3 pixels at (2, 1), in a display window of 7x6 pixels that begins at (1, 1)."""
    picture = rng.normal(size=(3, 4)).astype(np.float32)
    windows = {"dataWindow": ((2, 1), (5, 3)), "displayWindow": ((1, 1), (7, 6))}
    window = {name: tuple(np.array(corner, np.int32) for corner in corners) for name, corners in windows.items()}
    with OpenEXR.File({"type": OpenEXR.scanlineimage, **window}, {"Y": picture}) as file:
        file.write(str(tmp_path / "y.exr"))
    expected = np.zeros((6, 7, 3), np.float32)
    expected[0:3, 1:5] = picture[..., None]
    np.testing.assert_array_equal(exr.read_rgb(tmp_path / "y.exr"), expected)


@pytest.mark.parametrize("compression", ["NO", "RLE", "ZIPS", "ZIP", "PIZ"])
def test_tiles_and_parts_are_read(tmp_path: Path, rng: np.random.Generator, compression: str) -> None:
    """Files with several parts give the first part."""
    rgb = {name: rng.normal(size=(40, 50)).astype(np.float32) for name in "RGB"}
    header = {"compression": getattr(OpenEXR, f"{compression}_COMPRESSION"), "type": OpenEXR.scanlineimage}
    tiled = header | {"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription()}
    with OpenEXR.File(tiled, dict(rgb)) as file:
        file.write(str(tmp_path / "tiled.exr"))
    parts = [OpenEXR.Part(dict(header), dict(rgb), "a"), OpenEXR.Part(dict(header), {"Z": rgb["R"]}, "b")]
    with OpenEXR.File(parts) as file:
        file.write(str(tmp_path / "parts.exr"))
    for name in ("tiled.exr", "parts.exr"):
        found = exr.read_rgb(tmp_path / name)
        np.testing.assert_array_equal(found, np.stack([rgb[channel] for channel in "RGB"], axis=-1))


@pytest.mark.parametrize("piece", [1, 100, 1 << 20])
def test_plain_files_are_exact_for_us_and_for_the_library(
    tmp_path: Path, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch, piece: int
) -> None:
    """Files are read in pieces of one line, two lines and all lines. The channels are not in the file's order."""
    monkeypatch.setattr(exr_lines, "PIECE_BYTES", piece)
    picture = rng.normal(size=(7, 5, 4)).astype(np.float32)
    picture[0, 0] = [np.float32(1e-45), -0.0, np.inf, 3.4e38]
    strided = {name: picture[..., i] for i, name in enumerate("RGBA")}
    exr.write_plain(tmp_path / "p.exr", strided)
    seen: list[np.ndarray] = []
    found = exr.read_stacked(tmp_path / "p.exr", ("R", "G", "B", "A"), look=lambda rows: seen.append(rows.copy()))
    assert found.tobytes() == picture.tobytes() == np.concatenate(seen).tobytes()
    assert len(seen) == {1: 7, 100: 7, 1 << 20: 1}[piece]
    with OpenEXR.File(str(tmp_path / "p.exr"), separate_channels=True) as file:
        for name, channel in strided.items():
            assert file.channels()[name].pixels.tobytes() == channel.tobytes()
    counts = rng.integers(0, 1 << 32, (3, 4), dtype=np.uint32)
    exr.write_plain(tmp_path / "n.exr", {"N": counts})
    np.testing.assert_array_equal(exr.read_stacked(tmp_path / "n.exr", ("N",))[..., 0], counts)


def test_plain_files_that_others_wrote_are_read_the_same(tmp_path: Path, rng: np.random.Generator) -> None:
    """The library writes the files, uncompressed: in the product's layout, bottom up, in half precision, and mixed."""
    rgb = {name: rng.normal(size=(5, 4)).astype(np.float32) for name in "RGB"}
    halves = {name: values.astype(np.float16) for name, values in rgb.items()}
    header = {"compression": OpenEXR.NO_COMPRESSION, "type": OpenEXR.scanlineimage}
    upwards = header | {"lineOrder": OpenEXR.DECREASING_Y}
    kinds = [(header, rgb), (upwards, rgb), (header, halves), (header, rgb | {"G": halves["G"]})]
    for attributes, given in kinds:
        with OpenEXR.File(dict(attributes), dict(given)) as file:
            file.write(str(tmp_path / "p.exr"))
        found = exr.read_rgb(tmp_path / "p.exr")
        np.testing.assert_array_equal(found, np.stack([given[name] for name in "RGB"], axis=-1))


def test_damaged_plain_files_are_refused_in_one_line(tmp_path: Path, rng: np.random.Generator) -> None:
    """Without a checksum: missing ends, lines with wrong numbers, and a table with wrong offsets."""
    exr.write_plain(tmp_path / "p.exr", {"Y": rng.normal(size=(9, 6)).astype(np.float32)})
    content = (tmp_path / "p.exr").read_bytes()
    line = 8 + 6 * 4
    first = len(content) - 9 * line
    for missing in (1, line, 9 * line, 9 * line + 1):
        (tmp_path / "p.exr").write_bytes(content[:-missing])
        with pytest.raises(InputError, match=r"^\S+p\.exr: [^\n]+; export it again$"):
            exr.read_rgb(tmp_path / "p.exr")
    for at in (first, first + 4, first + 8 * line):  # y and byte count of the first line, y of the last line
        (tmp_path / "p.exr").write_bytes(content[:at] + b"\x63" + content[at + 1 :])
        with pytest.raises(InputError, match=r"^\S+p\.exr: not a readable .*lines from 0 on are not in their places"):
            exr.read_rgb(tmp_path / "p.exr")
    (tmp_path / "p.exr").write_bytes(content[: first - 8] + b"\xff" * 8 + content[first:])
    found = exr.read_rgb(tmp_path / "p.exr")  # passed to the library, which finds the lines without a table
    (tmp_path / "p.exr").write_bytes(content)
    np.testing.assert_array_equal(found, exr.read_rgb(tmp_path / "p.exr"))


def text(name: str) -> bytes:
    return name.encode() + b"\0"


def attribute(name: str, kind: str, value: bytes, length: int | None = None) -> bytes:
    return text(name) + text(kind) + struct.pack("<i", len(value) if length is None else length) + value


def channels(names: str | list[str], kind: int = FLOAT, sampling: int = 1) -> bytes:
    listed = b"".join(text(name) + struct.pack("<iIii", kind, 0, sampling, sampling) for name in names)
    return attribute("channels", "chlist", listed + b"\0")


def window(name: str, *corners: int) -> bytes:
    return attribute(name, "box2i", struct.pack("<4i", *corners))


def tiles(width: int, height: int) -> bytes:
    return attribute("tiles", "tiledesc", struct.pack("<IIB", width, height, 0))


def exr_file(
    listed: bytes, side: int = 8, more: bytes = b"", flags: int = 0, *, data: bytes | None = None, body: int = 4096
) -> bytes:
    """Header of a square picture, followed by zeros."""
    square = window("displayWindow", 0, 0, side - 1, side - 1)
    data = window("dataWindow", 0, 0, side - 1, side - 1) if data is None else data
    header = listed + attribute("compression", "compression", bytes([ZIP])) + square + data + more
    return struct.pack("<II", 20000630, 2 | flags) + header + b"\0" + bytes(body)


CLAIMS = {
    "40 channels": (exr_file(channels([f"a{i:02}" for i in range(40)] + list("RGB")), 4096), "43 channels of 2.7 GiB"),
    "60 channels": (exr_file(channels([f"a{i:02}" for i in range(60)] + list("RGB")), 4096), "63 channels of 3.9 GiB"),
    "2000 channels": (exr_file(channels([f"a{i:04}" for i in range(2000)])), "its channels are damaged or too many"),
    "pixels": (exr_file(channels("RGB"), 1 << 20), "claims 1048576x1048576 pixels, at most 268435456 are read"),
    "chunks": (exr_file(channels("RGB"), 16384, body=7000), "shorter than the table of its chunks"),
    "a wide chunk": (
        exr_file(channels("RGBA"), data=window("dataWindow", 0, 0, (1 << 24) - 1, 15)),
        "chunks of 16777216x16 pixels of 4 channels",
    ),
    "a tile": (exr_file(channels("RGB"), more=tiles(1 << 31, 1 << 31), flags=TILED), "chunks of 2147483648x2147483648"),
    "no tile": (exr_file(channels("RGB"), more=tiles(0, 8), flags=TILED), "tiles without pixels"),
    "no tiles": (exr_file(channels("RGB"), flags=TILED), "lacks windows, channels, compression or tiles"),
    "an attribute": (
        exr_file(channels("RGB"), more=attribute("owner", "string", b"", (1 << 31) - 1)),
        "its header is damaged or too long",
    ),
    "a negative attribute": (
        exr_file(channels("RGB"), more=attribute("owner", "string", b"", -1)),
        "its header is damaged or too long",
    ),
    "many attributes": (
        exr_file(channels("RGB"), more=b"".join(attribute(f"a{i}", "string", b"") for i in range(2000))),
        "its header is damaged or too long",
    ),
    "two windows": (exr_file(channels("RGB"), more=window("dataWindow", 0, 0, 1, 1)), "damaged or too long"),
    "two of a channel": (exr_file(channels("RGBR")), "its channels are damaged"),
    "an unknown type": (exr_file(channels("RGB", 7)), "its channels are damaged"),
    "no channels": (exr_file(channels("")), "it has no channels"),
    "open channels": (exr_file(attribute("channels", "chlist", b"R" * 40)), "its channels are damaged"),
    "subsampled": (exr_file(channels("RGB", sampling=2)), "its channels are subsampled"),
    "far off": (
        exr_file(channels("RGB"), data=window("dataWindow", 1 << 30, 0, (1 << 30) + 7, 7)),
        "a window from .1073741824, 0. to .1073741831, 7., too far off",
    ),
    "a window inside out": (exr_file(channels("RGB"), data=window("dataWindow", 7, 7, 0, 0)), "claims -6x-6 pixels"),
    "deep": (exr_file(channels("RGB"), flags=DEEP), "it holds deep pixels; flatten them"),
    "deep by its type": (
        exr_file(channels("RGB"), more=attribute("type", "string", b"deepscanline")),
        "it holds deep or unknown pixels; flatten them",
    ),
    "no parts": (struct.pack("<II", 20000630, 2 | MULTIPART) + bytes(9), "it holds no picture"),
    "many parts": (
        exr_file(channels("RGB"), flags=MULTIPART, body=0) + 99 * exr_file(channels("RGB"), body=0)[8:] + bytes(9),
        "more than 64 parts",
    ),
    "an endless name": (struct.pack("<II", 20000630, 2) + b"x" * 9999, "its header is damaged"),
    "the end": (exr_file(channels("RGB"), body=0)[:-40], "it ends inside its header"),
    "nothing": (b"", "it ends inside its header"),
    "another format": (b"\x89PNG\r\n\x1a\n" * 9, "not an OpenEXR file of version 2"),
    "another version": (struct.pack("<II", 20000630, 3) + bytes(99), "not an OpenEXR file of version 2"),
}


@pytest.mark.parametrize("kind", CLAIMS)
def test_what_a_header_claims_is_refused_before_it_is_decoded(tmp_path: Path, kind: str) -> None:
    content, complaint = CLAIMS[kind]
    (tmp_path / "p.exr").write_bytes(content)
    with pytest.raises(InputError, match=rf"p\.exr: .*{complaint}") as caught, little_memory():
        exr.read_rgb(tmp_path / "p.exr")
    assert len(str(caught.value)) < 500
    with pytest.raises(InputError, match=r"p\.exr: "):
        open_source(Medium.of(tmp_path / "p.exr"), None)


def test_a_picture_larger_than_memory_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "p.exr").write_bytes(exr_file(channels("RGB"), 8192))
    monkeypatch.setattr(memory, "available_bytes", lambda: 1 << 30)
    with pytest.raises(InputError, match=r"p\.exr: decoding it needs about 1\.5 GiB of memory, 1\.0 GiB are available"):
        exr.read_rgb(tmp_path / "p.exr")


def test_damaged_pixels_are_reported_in_one_line(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """The library's own messages appear neither in Python's output nor in the process's."""
    ramp = np.linspace(0, 1, 3 * 99 * 99, dtype=np.float32).reshape(99, 99, 3)
    exr.write_rgb(tmp_path / "p.exr", ramp)
    content = (tmp_path / "p.exr").read_bytes()
    for damaged in (content[:-5000], content[:700] + bytes(300) + content[1000:]):
        (tmp_path / "p.exr").write_bytes(damaged)
        with pytest.raises(InputError, match=r"^\S+p\.exr: its pixels cannot be decoded \(.+\); export it again$"):
            exr.read_rgb(tmp_path / "p.exr")
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("path", sorted(HOSTILE.rglob("*.exr")) or [HOSTILE], ids=lambda path: path.name)
def test_hostile_exr_files_are_read_or_refused_in_one_line(path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Read the shared hostile files if they exist, and otherwise the folder's name, which is no EXR file."""
    complaint = ""
    try:
        assert exr.read_rgb(path).ndim == 3
    except InputError as error:
        complaint = str(error)
    assert complaint == "" or (path.name in complaint and "\n" not in complaint)
    assert capfd.readouterr() == ("", "")

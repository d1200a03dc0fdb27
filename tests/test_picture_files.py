"""Picture files are read completely and as stored, or refused. Their size may not exceed what their bytes can hold."""

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from counterlight import memory
from counterlight.errors import InputError
from counterlight.files.picture_files import MOST_CHUNKS, decode, encode_png, read_picture
from counterlight.tools.simulation.materials import read_texture
from tests.hostile import little_memory

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_any_truncated_picture_is_refused(rng: np.random.Generator, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"whole{suffix}"
    cv2.imwrite(str(path), rng.integers(0, 256, (23, 31, 3), np.uint8))
    assert read_picture(path).shape == (23, 31, 3)
    content = path.read_bytes()
    for length in (*range(0, 200, 13), *range(200, len(content), 97), len(content) - 1):
        cut = tmp_path / f"cut{suffix}"
        cut.write_bytes(content[:length])
        with pytest.raises(InputError):
            read_picture(cut)


def test_a_flipped_bit_in_a_png_is_refused(rng: np.random.Generator, tmp_path: Path) -> None:
    path = tmp_path / "picture.png"
    cv2.imwrite(str(path), rng.integers(0, 256, (23, 31), np.uint8))
    content = bytearray(path.read_bytes())
    for at in range(0, len(content), 41):
        damaged = content.copy()
        damaged[at] ^= 4
        path.write_bytes(damaged)
        with pytest.raises(InputError):
            read_picture(path)
    damaged = content.copy()
    damaged[content.index(b"IDAT") + 40] ^= 4
    path.write_bytes(damaged)
    with pytest.raises(InputError, match=r"damaged PNG \(checksum"):  # by our own check, whatever the decoder reports
        read_picture(path)


def test_a_thumbnail_does_not_pass_for_the_end_of_a_jpeg(rng: np.random.Generator, tmp_path: Path) -> None:
    """A camera's JPEG contains a complete JPEG in its EXIF segment, with its own end marker."""
    _, encoded = cv2.imencode(".jpg", rng.integers(0, 256, (40, 56, 3), np.uint8))
    content = encoded.tobytes()
    _, small = cv2.imencode(".jpg", rng.integers(0, 256, (8, 8, 3), np.uint8))
    segment = b"Exif\0\0" + small.tobytes()
    with_thumbnail = content[:2] + b"\xff\xe1" + (len(segment) + 2).to_bytes(2, "big") + segment + content[2:]
    path = tmp_path / "camera.jpg"
    path.write_bytes(with_thumbnail + b"\0\0\0\0")
    assert read_picture(path).shape == (40, 56, 3)
    path.write_bytes(with_thumbnail[: len(with_thumbnail) // 2 + len(segment) // 2])
    with pytest.raises(InputError, match="truncated"):
        read_picture(path)


def test_pictures_keep_depth_and_channel_order(tmp_path: Path) -> None:
    deep = np.arange(35, dtype=np.uint16).reshape(5, 7) * 1801
    cv2.imwrite(str(tmp_path / "deep.png"), deep)
    np.testing.assert_array_equal(read_picture(tmp_path / "deep.png"), deep)
    rgba = np.zeros((5, 7, 4), np.uint8)
    rgba[..., 2], rgba[..., 3] = 200, 9  # OpenCV's order is blue, green, red, alpha
    cv2.imwrite(str(tmp_path / "red.png"), rgba)
    np.testing.assert_array_equal(read_picture(tmp_path / "red.png")[2, 3], [200, 0, 0])


def test_hostile_pictures_are_read_or_refused() -> None:
    for path in sorted((SHARED / "hostile").rglob("*")) if SHARED.is_dir() else []:
        if path.is_file():
            assert "\n" not in refusal_of(path)


def refusal_of(path: Path) -> str:
    try:
        read_picture(path)
    except InputError as error:
        return str(error)
    return ""


# What a header claims


def chunk(kind: bytes, body: bytes = b"") -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def png(width: int, height: int, *more: bytes, coded: bytes = b"", bits: int = 8, colour: int = 0) -> bytes:
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + header + b"".join(more) + chunk(b"IDAT", zlib.compress(coded)) + chunk(b"IEND")


def jpeg(width: int, height: int, scans: int = 1, frames: int = 1, padding: int = 0, more: bytes = b"") -> bytes:
    frame = b"\xff\xc0" + struct.pack(">HBHHB", 11, 8, height, width, 1) + b"\x01\x11\x00"
    scan = b"\xff\xda" + struct.pack(">HB", 8, 1) + b"\x01\x00\x00\x3f\x00" + bytes(9)
    return b"\xff\xd8" + more + frame * frames + scan * scans + b"\xff" * padding + b"\xff\xd9"


CLAIMS = {
    "60000x60000": (png(60000, 60000, coded=bytes(4 << 20)), "that claims 60000x60000 pixels|at most 16384 a side"),
    "16384x16384": (png(16384, 16384), "a PNG of 8 bytes that claims 16384x16384 pixels"),
    "16 bits": (png(16384, 16384, coded=bytes(99), bits=16, colour=6), "a PNG of .* bytes that claims 16384x16384"),
    "two headers": (png(9, 9, png(9999, 9999)[8:33], coded=bytes(90)), "it begins with no header, or has two"),
    "no header": (b"\x89PNG\r\n\x1a\n" + chunk(b"IDAT") + chunk(b"IEND"), "it begins with no header, or has two"),
    "a short header": (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", b"12") + chunk(b"IEND"), "unpack"),
    "chunks": (png(9, 9, chunk(b"tEXt") * MOST_CHUNKS, coded=bytes(90)), f"a PNG of more than {MOST_CHUNKS} chunks"),
    "a JPEG of 16384x16384": (jpeg(16384, 16384), "a JPEG of .* bytes that claims 16384x16384 pixels"),
    "no size": (jpeg(9, 0), "claims 9x0 pixels"),
    "scans": (jpeg(64, 64, scans=99), "a damaged JPEG .1 frames of 99 scans"),
    "frames": (jpeg(64, 64, frames=2), "a damaged JPEG .2 frames of 1 scans"),
    "no frame": (jpeg(64, 64, frames=0), "a damaged JPEG .0 frames of 1 scans"),
    "segments": (jpeg(64, 64, more=b"\xff\xe0\x00\x02" * 20000), "without its end marker"),
    "padding": (jpeg(64, 64, padding=10 << 20), "cannot be decoded as an 8- or 16-bit picture"),
    "a long file": (png(9, 9, coded=bytes(90)) + bytes(80 << 20), None),
}


@pytest.mark.parametrize("kind", CLAIMS)
def test_what_a_header_claims_is_refused_before_it_is_decoded(
    tmp_path: Path, kind: str, capfd: pytest.CaptureFixture[str]
) -> None:
    """Nothing else is printed, although libpng and OpenCV write to the process's stderr."""
    content, complaint = CLAIMS[kind]
    (tmp_path / "p").write_bytes(content)
    with little_memory():
        if complaint is None:
            assert read_picture(tmp_path / "p").shape == (9, 9)
        with pytest.raises(InputError, match=complaint or "more than the 67108872 bytes that are read"):
            read_picture(tmp_path / "p", 1 if complaint is None else 16384**2)
    assert capfd.readouterr() == ("", "")


def test_a_picture_larger_than_wanted_or_than_memory_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "p.png").write_bytes(png(100, 50, coded=bytes(50 * 101)))
    assert read_picture(tmp_path / "p.png", 5000).shape == (50, 100)
    with pytest.raises(InputError, match=r"p\.png: claims 100x50 pixels, at most 16384 a side and 4999 in all"):
        read_picture(tmp_path / "p.png", 4999)
    monkeypatch.setattr(memory, "available_bytes", lambda: 60_000)
    with pytest.raises(InputError, match=r"p\.png: decoding it needs about 0\.0 GiB of memory"):
        read_picture(tmp_path / "p.png")


def test_only_what_is_shown_upright_is_turned(tmp_path: Path) -> None:
    """Captures stay as the camera stored them. Textures are turned as their EXIF tag says (6: to the right)."""
    _, encoded = cv2.imencode(".jpg", np.zeros((8, 24, 3), np.uint8))
    exif = b"Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0"
    segment = b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif
    (tmp_path / "p.jpg").write_bytes(encoded.tobytes()[:2] + segment + encoded.tobytes()[2:])
    assert read_picture(tmp_path / "p.jpg").shape == (8, 24, 3)
    assert read_texture(tmp_path / "p.jpg", "here").shape == (24, 8, 3)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("shape", [(5, 7), (5, 7, 3), (1, 1, 3)])
def test_pictures_are_read_as_they_were_written(rng: np.random.Generator, dtype: type, shape: tuple[int, ...]) -> None:
    """Our reader and OpenCV both read PNGs written from a view whose rows are not contiguous."""
    picture = rng.integers(0, np.iinfo(dtype).max, shape, dtype, endpoint=True)[:, ::-1]
    content = encode_png(picture)
    np.testing.assert_array_equal(decode(content, "p.png"), picture)
    other = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(other if picture.ndim == 2 else other[..., ::-1], picture)
    with pytest.raises(InputError, match="truncated"):
        decode(content[:-9], "p.png")

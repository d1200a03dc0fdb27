"""Media of other programs, names without files, and lines that are too long: each has one reported cause."""

import struct
from pathlib import Path

import av
import numpy as np
import pytest

from counterlight.app import _check_window
from counterlight.errors import InputError
from counterlight.media.decoding.ffmpeg_source import known_tags
from counterlight.media.decoding.opening import reason
from counterlight.media.medium import Medium
from counterlight.overlay.osd import Page, draw
from counterlight.show.command_line import read_options
from tests.media import read
from tests.stage import Stage

# Tags that change how pixels are stored, or whose value is not a plain number.
ALTERS = {266, 282, 283, 292, 293, 317, 320, 322, 323, 324, 325, 330, 530}


@pytest.mark.parametrize("compression", ["raw", "packbits", "lzw", "deflate"])
def test_tiffs_of_ffmpeg_are_exact_and_damaged_ones_are_refused(
    tmp_path: Path, rng: np.random.Generator, compression: str
) -> None:
    """FFmpeg writes resolution and software tags that its own strict decoder refuses."""
    picture, path = rng.integers(0, 256, (9, 15, 3), np.uint8), tmp_path / "p.tiff"
    with av.open(str(path), "w", format="image2", options={"update": "1"}) as container:
        stream = container.add_stream("tiff", rate=1, options={"compression_algo": compression})
        assert isinstance(stream, av.VideoStream)
        stream.width, stream.height, stream.pix_fmt = 15, 9, "rgb24"
        container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode(None))
    ((_, planes),) = read(path)
    np.testing.assert_array_equal(np.dstack(planes)[:9, :15], picture)
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(InputError, match="damaged"):
        read(path)


def test_every_tag_that_is_kept_is_one_that_ffmpeg_reads(tmp_path: Path, rng: np.random.Generator) -> None:
    """Tags of ImageMagick and libtiff, such as orientation, chromaticities and extra samples, are removed."""
    picture, path = rng.integers(0, 256, (9, 15, 3), np.uint8), tmp_path / "p.tif"
    fields = {256: (3, 15), 257: (3, 9), 258: (3, 8), 259: (3, 1), 262: (3, 2), 273: (4, 8), 277: (3, 3), 278: (3, 9)}
    fields |= {279: (4, picture.nbytes), 284: (3, 1)}
    fields |= {tag: (3, 1) for tag in range(255, 600) if tag not in fields and tag not in ALTERS}
    index = b"".join(struct.pack("<HHII", tag, kind, 1, value) for tag, (kind, value) in sorted(fields.items()))
    start = struct.pack("<4sI", b"II*\0", 8 + picture.nbytes)
    path.write_bytes(start + picture.tobytes() + struct.pack("<H", len(fields)) + index + b"\0" * 4)
    ((_, planes),) = read(path)
    np.testing.assert_array_equal(np.dstack(planes)[:9, :15], picture)


def test_bytes_that_are_no_tiff_stay(rng: np.random.Generator) -> None:
    for head in (b"", b"II*\0", b"II*\0\xff\xff\xff\xff", b"MM\0*\0\0\0\x08\xff\xff", b"\x89PNG"):
        data = head + rng.bytes(20 if head[:2] == b"\x89P" else 0)
        assert known_tags(data) == data


@pytest.mark.parametrize(
    ("name", "message"),
    [("http://x/a.mp4", "http addresses are not played; download"), ("file:///a.mp4", "give its path")],
)
def test_addresses_that_are_not_played_are_no_missing_files(name: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Medium(name).check()


def test_ffmpeg_that_gave_up_has_had_no_answer() -> None:
    assert reason(av.ExitError(1, "Immediate exit requested")) == "no answer in time"


def test_a_media_root_and_a_leader_are_looked_for_at_the_start(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"--media-root .*none: no such folder"):
        read_options(["room", "clip", "--no-config", "--media-root", str(tmp_path / "none")], "")
    options = read_options(["room", "clip", "--no-config", "--screenshot-directory", str(tmp_path)], "")
    options.follow = "nohost.invalid", 5
    with pytest.raises(InputError, match=r"--follow nohost\.invalid: "):
        _check_window(options)


def test_long_lines_are_broken_in_a_narrow_window() -> None:
    line = " ".join(["monument"] * 20)
    for page in (Page((line,)), Page((f"name\t{line}", "a\tb"))):
        ink = draw(page, (600, 200))[..., 0]
        rows = ink.max(axis=1) > 0
        assert np.diff(rows.astype(int)).clip(0).sum() > 5  # lines of letters
        assert not ink[:, -2:].any()  # no text reaches the edge


def test_escape_closes_the_help_before_it_ends_the_placing() -> None:
    stage = Stage()
    stage.advance(0.1)
    stage.press("k", "?")
    stage.press("escape")
    assert (stage.commands.get("help"), stage.commands.get("placing")) == (False, True)
    stage.press("escape")
    assert not stage.commands.get("placing")


def test_an_interrupted_show_has_been_counted() -> None:
    counted = []
    stage = Stage()
    stage.show._on_interrupt = counted.append

    def interrupt(timeout_s: float) -> list[str]:
        stage.clock.now += 0.01
        if stage.session.stats.frames > 3:
            raise KeyboardInterrupt
        return []

    stage.screen.poll = interrupt  # type: ignore[method-assign]
    with pytest.raises(KeyboardInterrupt):
        stage.show.run()
    assert counted[0].frames > 3

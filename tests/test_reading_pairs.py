"""Pictures and photographs of pairs: orientation tags, formats, sizes, and folders of data sets."""

import tracemalloc
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import ExifTags, Image

from counterlight.errors import InputError
from counterlight.tools.pairs.fitting import fit_pairs
from counterlight.tools.pairs.matching import matched
from counterlight.tools.pairs.photographs import read_photographs, read_pictures
from counterlight.tools.pairs.room import PairsOptions, find_pairs
from tests.dng import dng, mosaic_of
from tests.pairs_of_rooms import CAMERA, GAMMA, Wall, natural_pictures, write, write_pairs

UPRIGHT = {1: 0, 3: 2, 6: -1, 8: 1}  # counterclockwise quarter turns by EXIF orientation


def write_turned(path: Path, codes: np.ndarray, orientation: int) -> None:
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = orientation
    if path.suffix == ".dng":
        path.write_bytes(dng(mosaic_of(codes.astype(np.float64) * 257), orientation=orientation))
    else:
        Image.fromarray(codes).save(path, exif=exif, quality=100, subsampling=0)


@pytest.mark.parametrize("orientation", UPRIGHT)
@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tiff", ".dng"])
def test_pictures_are_read_upright_in_every_format(
    tmp_path: Path, rng: np.random.Generator, suffix: str, orientation: int
) -> None:
    """A viewer shows a picture upright, so the projector did, too."""
    coarse = rng.integers(0, 256, (3, 4, 3), np.uint8)
    codes = np.ascontiguousarray(np.kron(coarse, np.ones((16, 16, 1), np.uint8)))
    path = tmp_path / f"picture{suffix}"
    write_turned(path, codes, orientation)
    expected = np.rot90(codes, UPRIGHT[orientation])
    found = read_pictures([path])[0]
    inside = np.kron(np.ones((3, 4)), np.pad(np.ones((8, 8)), 4)).astype(bool)  # JPEG blurs the edges of blocks
    inside = np.rot90(inside, UPRIGHT[orientation])
    assert found.shape == expected.shape
    assert np.abs(found.astype(int) - expected)[inside].max() <= 3  # JPEG rounds luma and colour differences
    light = read_photographs([path], None)[0]
    assert light.shape == expected.shape
    assert light[inside][found[inside] > 128].min() > light[inside][found[inside] < 64].max()


@pytest.mark.parametrize(
    ("size", "usual"),
    [((96, 48), "128x96"), ((256, 192), "128x96"), ((24, 18), "128x96"), ((48, 64), "128x96")],
    ids=["stretched", "larger", "tiny", "turned"],
)
def test_sizes_that_photographs_cannot_be_reduced_to_are_refused(
    tmp_path: Path, size: tuple[int, int], usual: str
) -> None:
    write(tmp_path / "a.png", np.zeros((*CAMERA, 3), np.uint16))
    with pytest.raises(InputError, match=f"128x96 cannot be reduced to {size[0]}x{size[1]}; .* such as {usual}"):
        read_photographs([tmp_path / "a.png"], None, size)


@pytest.mark.parametrize("size", [(128, 96), (64, 48), (90, 67), (90, 68)])
def test_photographs_are_reduced_to_a_size_of_their_shape(tmp_path: Path, size: tuple[int, int]) -> None:
    write(tmp_path / "a.png", np.full((*CAMERA, 3), 13107, np.uint16))
    found = read_photographs([tmp_path / "a.png"], None, size)
    assert found.shape == (1, size[1], size[0], 3)
    np.testing.assert_allclose(found, 0.2, rtol=1e-6)  # rounding to float32


def test_content_contradicts_numbers(tmp_path: Path, rng: np.random.Generator) -> None:
    """The first photograph is missing, and the numbers of the others are one too low."""
    pictures, photographs = write_pairs(tmp_path, Wall(), rng, 12)
    (photographs / "IMG_000.png").unlink()
    for number in range(1, 12):
        (photographs / f"IMG_{number:03}.png").rename(photographs / f"IMG_{number - 1:03}.png")
    pairs, by, unmatched = find_pairs(pictures, photographs, PairsOptions())
    assert (by, unmatched) == ("content", [])
    assert [pair.name for pair in pairs] == [f"frame{n + 1:03}.png with IMG_{n:03}.png" for n in range(11)]


def test_numbers_decide_between_pictures_that_are_alike(rng: np.random.Generator) -> None:
    pictures = natural_pictures(rng, 12)
    pictures[6] = np.clip(pictures[5] + rng.normal(0, 4, pictures[5].shape), 0, 255)
    order = np.arange(12)
    order[[5, 6]] = 6, 5
    captures = [Wall().capture(pictures[n], rng, noise=0) ** (1 / GAMMA) / 65535 ** (1 / GAMMA) for n in order]
    np.testing.assert_array_equal(matched(pictures / 255, captures), order)
    np.testing.assert_array_equal(matched(pictures / 255, captures, numbered=True), np.arange(12))


def test_matching_keeps_only_small_copies(rng: np.random.Generator) -> None:
    width, height, count = 1200, 900, 24
    codes = natural_pictures(rng, count)
    captures = [Wall().capture(each, rng) for each in codes]

    def large(pictures: np.ndarray | list[np.ndarray], top: float) -> Iterator[np.ndarray]:
        for each in pictures:
            yield cv2.resize(each, (width, height)) ** (1 if top == 255 else 1 / GAMMA) / np.float32(top)

    tracemalloc.start()
    found = matched(large(codes, 255), large(captures, 65535 ** (1 / GAMMA)))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    np.testing.assert_array_equal(found, np.arange(count))
    assert peak < 8 * 4 * 3 * width * height  # bytes: eight float32 pictures, where reading all takes 48


@pytest.mark.parametrize("primary", range(3))
def test_pictures_without_change_in_one_primary_are_refused(rng: np.random.Generator, primary: int) -> None:
    name = ("red", "green", "blue")[primary]
    pictures = natural_pictures(rng, 9)
    captures = np.stack([Wall().capture(each, rng) for each in pictures]) / np.float32(65535)
    constant = captures.copy()
    constant[..., primary] = constant[0, ..., primary]
    with pytest.raises(InputError, match=f"photographs are all alike in {name}"):
        fit_pairs(pictures, constant, additive=True)
    pictures[..., primary] = 100
    with pytest.raises(InputError, match=f"pictures are all alike in {name}"):
        fit_pairs(pictures, captures, additive=True)

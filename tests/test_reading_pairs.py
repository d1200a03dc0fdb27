"""Pictures and photographs of pairs: orientation tags, formats, sizes, and folders of data sets."""

from pathlib import Path

import numpy as np
import pytest
from PIL import ExifTags, Image

from counterlight.tools.pairs.photographs import read_photographs, read_pictures
from tests.dng import dng, mosaic_of

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

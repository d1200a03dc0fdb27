"""Find the pairs of a data set: its training and held-out pictures and photographs."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from counterlight.tools.pairs.matching import matched
from counterlight.tools.pairs.photographs import number_of, read_photograph

SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff")
HELD = 8  # one of so many pairs is held out where a data set does not say which


@dataclass(frozen=True)
class DataSet:
    """Pairs of one room: code values (uint8) of pictures, and linear light of captures, (pairs, height, width, 3)."""

    pictures: NDArray[np.uint8]
    captures: NDArray[np.float32]
    names: list[str]


def read_data_set(
    folder: Path, pictures: str | None, photographs: str | None, size: tuple[int, int] | None
) -> tuple[DataSet, DataSet | None]:
    """Read the training pairs, and the held-out pairs if the data set has them in a folder of their own.

    pictures, photographs : folders below `folder`; None for the layout of the CompenNet data sets.
    size : (width, height) to reduce captures to; None for half their size.
    """
    if pictures and photographs:
        return _read(folder / pictures, folder / photographs, size), None
    shared = next((each for each in (folder / "prj" / "share", folder / "prj") if (each / "train").is_dir()), None)
    camera = folder / "cam" / "raw"
    if shared is None or not (camera / "train").is_dir():
        raise SystemExit(
            f"{folder}: no prj/share/train and cam/raw/train; name the folders with --pictures and --photographs"
        )
    train = _read(shared / "train", camera / "train", size)
    has_test = (shared / "test").is_dir() and (camera / "test").is_dir()
    return train, _read(shared / "test", camera / "test", size) if has_test else None


def _read(pictures: Path, photographs: Path, size: tuple[int, int] | None) -> DataSet:
    shown, seen = _files(pictures), _files(photographs)
    light = np.stack([_light(path, size) for path in seen])
    by_number = {number_of(path): path for path in shown}
    alike = len(by_number) == len(shown) == len(seen) and all(number_of(path) in by_number for path in seen)
    if alike:
        chosen, kept = [by_number[number_of(path)] for path in seen], np.arange(len(seen))
    else:
        numbers = matched([_codes(path) / np.float32(255) for path in shown], list(light ** (1 / 2.2)))
        if numbers is None:
            raise SystemExit(f"{photographs}: does not show the pictures in {pictures}")
        kept = np.flatnonzero(numbers >= 0)
        chosen = [shown[numbers[number]] for number in kept]
    names = [f"{path.name}={seen[number].name}" for path, number in zip(chosen, kept, strict=True)]
    return DataSet(np.stack([_codes(path) for path in chosen]), light[kept], names)


def _files(folder: Path) -> list[Path]:
    found = [path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES]
    return sorted(found, key=lambda path: (number_of(path) or 0, path.name))


def _codes(path: Path) -> NDArray[np.uint8]:
    return np.asarray(cv2.imread(str(path), cv2.IMREAD_COLOR)[..., ::-1], np.uint8)


def _light(path: Path, size: tuple[int, int] | None) -> NDArray[np.float32]:
    picture = read_photograph(path)
    picture = picture if picture.ndim == 3 else np.repeat(picture[..., None], 3, axis=2)
    light = picture / np.float32(np.iinfo(picture.dtype).max)
    if picture.dtype == np.uint8:
        light = np.where(light <= 0.04045, light / 12.92, ((light + 0.055) / 1.055) ** 2.4)
    size = size or (picture.shape[1] // 2, picture.shape[0] // 2)
    return np.asarray(cv2.resize(light, size, interpolation=cv2.INTER_AREA), np.float32)

"""Find the pairs of a data set: its training and held-out pictures and photographs."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from counterlight.tools.pairs.matching import matched
from counterlight.tools.pairs.photographs import (
    Pair,
    Size,
    files_in,
    pairs_by_number,
    read_photograph,
    read_photographs,
    read_pictures,
)

HELD = 8  # one of so many pairs is held out where a data set does not say which


@dataclass(frozen=True)
class DataSet:
    """Pairs of one room: code values (uint8) of pictures, and linear light of captures, (pairs, height, width, 3)."""

    pictures: NDArray[np.uint8]
    captures: NDArray[np.floating]
    names: list[str]


def read_data_set(
    folder: Path, pictures: str | None, photographs: str | None, size: Size | None
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


def _read(pictures: Path, photographs: Path, size: Size | None) -> DataSet:
    shown, seen = files_in(pictures), files_in(photographs)
    height, width = read_photograph(seen[0]).shape[:2]
    light = read_photographs(seen, None, size or (width // 2, height // 2))
    pairs = pairs_by_number(shown, seen) if len(shown) == len(seen) else None
    kept = np.arange(len(seen))
    if pairs is None:
        numbers = matched(list(read_pictures(shown) / np.float32(255)), list(light ** (1 / 2.2)))
        if numbers is None:
            raise SystemExit(f"{photographs}: does not show the pictures in {pictures}")
        kept = np.flatnonzero(numbers >= 0)
        pairs = [Pair(shown[numbers[number]], seen[number]) for number in kept]
    codes = read_pictures([pair.picture for pair in pairs])
    return DataSet(codes, light[kept], [f"{pair.picture.name}={pair.photograph.name}" for pair in pairs])

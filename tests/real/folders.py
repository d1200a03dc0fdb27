"""Find the pairs of a data set: its training and held-out pictures and photographs."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from counterlight.errors import InputError
from counterlight.tools.pairs.geometry import NO_MATCH
from counterlight.tools.pairs.photographs import (
    Size,
    files_in,
    read_photograph,
    read_photographs,
    read_pictures,
    set_up_folders,
)
from counterlight.tools.pairs.room import matched_files

HELD = 8  # one pair in HELD is held out if the data set does not name held-out pairs


@dataclass(frozen=True)
class DataSet:
    """Pairs of one room: code values (uint8) of pictures, and linear light of captures, (pairs, height, width, 3)."""

    pictures: NDArray[np.uint8]
    captures: NDArray[np.floating]
    names: list[str]

    def check_like(self, train: "DataSet") -> None:
        """Refuse held-out pairs of other sizes than the training pairs."""
        for mine, others in ((self.pictures, train.pictures), (self.captures, train.captures)):
            if mine.shape[1:] != others.shape[1:]:
                sizes = [f"{shape[2]}x{shape[1]}" for shape in (mine.shape, others.shape)]
                raise InputError(f"{self.names[0]}: {sizes[0]}, but the training pairs have {sizes[1]}")


def read_data_set(
    folder: Path, pictures: str | None, photographs: str | None, size: Size | None
) -> tuple[DataSet, DataSet | None]:
    """Read the training pairs, and the held-out pairs if the data set has them in a folder of their own.

    pictures, photographs : folders below `folder`; None for the layout of the CompenNet data sets.
    size : (width, height) to reduce captures to; None for half their size.
    """
    if bool(pictures) != bool(photographs):
        raise InputError(f"{folder}: name both folders, with --pictures and --photographs")
    if pictures and photographs:
        return _read(folder / pictures, folder / photographs, size), None
    train, test = (set_up_folders(folder, folder, part) for part in ("train", "test"))
    if train is None:
        raise InputError(f"{folder}: no cam/raw/train; name the folders with --pictures and --photographs")
    both = _read(*train, size), _read(*test, size) if test else None
    if both[1]:
        both[1].check_like(both[0])
    return both


def _read(pictures: Path, photographs: Path, size: Size | None) -> DataSet:
    shown, seen = files_in(pictures), files_in(photographs)
    for folder, found in ((pictures, shown), (photographs, seen)):
        if not found:
            raise InputError(f"{folder}: no pictures; expected PNG, JPEG, TIFF or camera RAW")
    pairs, _ = matched_files(shown, seen, None)
    if not pairs:
        raise InputError(f"{photographs}: {NO_MATCH}")
    height, width = read_photograph(seen[0]).shape[:2]
    light = read_photographs([pair.photograph for pair in pairs], None, size or (width // 2, height // 2))
    codes = read_pictures([pair.picture for pair in pairs])
    return DataSet(codes, light, [f"{pair.picture.name}={pair.photograph.name}" for pair in pairs])

"""Process the camera picture in bands, whose pixels are read, settled and solved independently.

The measurements of a level are needed again only when all levels are combined. For a large camera they wait on disk,
in anonymous temporary files that are removed on any exit.
"""

import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from counterlight.tools.acquisition.plan import Captures
from counterlight.tools.acquisition.schemes.agreement import Reading, keep_measurable
from counterlight.tools.acquisition.schemes.blocks import BlockLight
from counterlight.tools.acquisition.schemes.known import KnownLight

PIXELS = 1 << 16  # camera pixels per band
CONNECTIONS = 1 << 22  # connections that are read from a capture at a time
SIDE_BY_SIDE = 2  # bands that are in memory at a time to be evaluated or solved


class Band:
    """A band of the camera's pixels.

    pixels : slice of the camera's pixels.
    root : their light from the single block of level 0; its `camera` counts from the band's first pixel.
    active : light of the blocks that will be divided next.
    known : light that is settled.
    """

    def __init__(self, pixels: slice, root: BlockLight, scratch: Path | None) -> None:
        self.pixels, self.root, self.active = pixels, root, root
        self.known, self.readings = KnownLight(self.count, root.grid.projector), Readings(scratch)

    @property
    def count(self) -> int:
        return int(self.pixels.stop - self.pixels.start)

    def settle(self, reading: Reading) -> None:
        """Apply the reading of a level: measurable light becomes active, the rest becomes known."""
        self.active, settled = keep_measurable(self.active, reading.light, reading.lit, reading.rest)
        for part in settled:
            self.known.add(part)
        self.readings.add(reading)


def at_once(bands: Sequence[Band]) -> Iterator[list[Band]]:
    """Yield groups of bands with limited connections, because each capture is decoded once per group."""
    some, count = list[Band](), 0
    for band in bands:
        if some and count + band.active.camera.size > CONNECTIONS:
            yield some
            some, count = [], 0
        some.append(band)
        count += band.active.camera.size
    yield some


def in_turn(captures: Captures) -> Iterator[NDArray[np.floating]]:
    """Yield the captures in order, while the next one is read from disk and decoded."""
    count = len(captures)
    with ThreadPoolExecutor(1) as reader:
        coming = [reader.submit(captures.__getitem__, 0)] if count else []
        for following in range(1, count + 1):
            current = coming.pop()
            if following < count:
                coming.append(reader.submit(captures.__getitem__, following))
            yield current.result()


def drained(bands: list[Band]) -> Iterator[Band]:
    """Yield each band and drop it from the list."""
    while bands:
        yield bands.pop(0)


class Readings:
    """The readings of a band, level by level.

    folder : folder of their temporary file; None keeps them in memory.
    """

    def __init__(self, folder: Path | None) -> None:
        self._kept, self._levels = list[Reading](), 0
        self._file = None if folder is None else tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 - until they are taken

    def add(self, reading: Reading) -> None:
        """Store a reading; OSError if the disk is full."""
        if self._file is None:
            self._kept.append(reading)
            return
        for field in fields(Reading):
            np.save(self._file, getattr(reading, field.name), allow_pickle=False)
        self._levels += 1

    def taken(self) -> list[Reading]:
        """Returns all readings and frees them; can be called once."""
        if self._file is not None:
            with self._file as file:
                file.seek(0)
                each = [[np.load(file, allow_pickle=False) for _ in fields(Reading)] for _ in range(self._levels)]
            return [Reading(*arrays) for arrays in each]
        kept, self._kept = self._kept, []
        return kept

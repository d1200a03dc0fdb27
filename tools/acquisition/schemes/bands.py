"""Camera pixels some at a time: what one sees is read, settled and solved without the others.

What a level measured is only needed again when all levels are made to agree. Of a large camera's it waits on disk, in
files without a name that go with the process, however that ends.
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

PIXELS = 1 << 16  # of a camera in one band
CONNECTIONS = 1 << 22  # that are read off a picture at a time
SIDE_BY_SIDE = 2  # bands that are settled or solved at a time: arrays of both are in memory


class Band:
    """Some of a camera's pixels.

    pixels : which.  root : their light of the floodlight's one block; its `camera` counts from the first of them.
    active : what they see of the blocks that are to be cut.  known : their light that is settled.
    """

    def __init__(self, pixels: slice, root: BlockLight, scratch: Path | None) -> None:
        self.pixels, self.root, self.active = pixels, root, root
        self.known, self.readings = KnownLight(self.count, root.grid.projector), Readings(scratch)

    @property
    def count(self) -> int:
        return int(self.pixels.stop - self.pixels.start)

    def settle(self, reading: Reading) -> None:
        """A level is read: what is measurable is to be cut next, and what is not is known."""
        self.active, settled = keep_measurable(self.active, reading.light, reading.lit, reading.rest)
        for part in settled:
            self.known.add(part)
        self.readings.add(reading)


def at_once(bands: Sequence[Band]) -> Iterator[list[Band]]:
    """Bands with not too many connections together, at least one: a capture is decoded once for all of them."""
    some, count = list[Band](), 0
    for band in bands:
        if some and count + band.active.camera.size > CONNECTIONS:
            yield some
            some, count = [], 0
        some.append(band)
        count += band.active.camera.size
    yield some


def in_turn(captures: Captures) -> Iterator[NDArray[np.floating]]:
    """One after the other; the next is read from disk and decoded meanwhile."""
    count = len(captures)
    with ThreadPoolExecutor(1) as reader:
        coming = [reader.submit(captures.__getitem__, 0)] if count else []
        for following in range(1, count + 1):
            current = coming.pop()
            if following < count:
                coming.append(reader.submit(captures.__getitem__, following))
            yield current.result()


def drained(bands: list[Band]) -> Iterator[Band]:
    """Each of them, given away."""
    while bands:
        yield bands.pop(0)


class Readings:
    """What was read of a band, level by level.

    folder : of the file in which they wait; None keeps them in memory.
    """

    def __init__(self, folder: Path | None) -> None:
        self._kept, self._levels = list[Reading](), 0
        self._file = None if folder is None else tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 - until they are taken

    def add(self, reading: Reading) -> None:
        """OSError where the disk refuses."""
        if self._file is None:
            self._kept.append(reading)
            return
        for field in fields(Reading):
            np.save(self._file, getattr(reading, field.name), allow_pickle=False)
        self._levels += 1

    def taken(self) -> list[Reading]:
        """All of them, once; they are given away."""
        if self._file is not None:
            with self._file as file:
                file.seek(0)
                each = [[np.load(file, allow_pickle=False) for _ in fields(Reading)] for _ in range(self._levels)]
            return [Reading(*arrays) for arrays in each]
        kept, self._kept = self._kept, []
        return kept

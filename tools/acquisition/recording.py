"""Take the missing captures of levels, average them, and print how long the rest takes."""

import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Protocol, overload

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray
from counterlight.command import LOG_INTERVAL_S, progress_bar
from counterlight.raster import Region, Shape
from counterlight.response import Response
from counterlight.tools.acquisition.averaging import Aim, Averaging, error_by_noise
from counterlight.tools.acquisition.cameras.camera import Camera, Shot
from counterlight.tools.acquisition.cameras.folder import FolderCamera
from counterlight.tools.acquisition.pace import CHECKS_S, Clock, Pace, computing_s, duration
from counterlight.tools.acquisition.plan import Expected, LazyPatterns, Level, Picture, Reference


class Store(Protocol):
    """Storage of captures: on disk (store.py) or in memory.

    halves : whether it contains a picture and its complement (linearity.py).
    coloured : whether it contains ramps and primaries.
    averaged : whether pictures may be captured several times.
    """

    @property
    def halves(self) -> bool: ...
    @property
    def coloured(self) -> bool: ...
    @property
    def averaged(self) -> bool: ...
    def repeats(self, level: int, choose: Callable[[], int]) -> int:
        """Returns a level's captures per picture; `choose` decides in the first run. Levels are numbered in order."""

    def has_curve(self, choose: Callable[[], bool]) -> bool:
        """Returns whether the captures include pictures of the camera's curve; `choose` decides in the first run."""

    def includes(self, what: str, number: int, choose: Callable[[], bool]) -> bool:
        """Returns whether the captures include pictures of a projector (from 1); `choose` decides in the first run."""

    def develop(self, response: Response) -> None:
        """Read the captures with this curve of the camera from now on."""

    def has(self, number: int) -> bool: ...
    def save(self, number: int, shots: Sequence[Shot]) -> None: ...
    def shots(self, number: int) -> Sequence[Shot]: ...
    def radiance(self, number: int) -> NDArray[np.float32]: ...
    def size(self, number: int) -> int:
        """Returns the bytes of a capture on disk."""


INTRODUCED = 2  # captures (black and white) after which the acquisition first prints its expected duration


class StoredCaptures(Sequence[NDArray[np.float32]]):
    """Radiance of pictures, read on access.

    first : number of the first capture.
    count : number of pictures.
    repeats : captures per picture.
    """

    def __init__(self, store: Store, first: int, count: int, repeats: int) -> None:
        self._store, self._first, self._count, self.repeats = store, first, count, repeats

    def __len__(self) -> int:
        return self._count

    @overload
    def __getitem__(self, index: int) -> NDArray[np.float32]: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[NDArray[np.float32]]: ...
    def __getitem__(self, index: int | slice) -> NDArray[np.float32] | Sequence[NDArray[np.float32]]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(self._count))]
        if not 0 <= index < self._count:
            raise IndexError(index)
        first = self._first + index * self.repeats
        if self.repeats == 1:
            return self._store.radiance(first)
        total = np.zeros((), np.float64)
        for number in range(first, first + self.repeats):
            total = total + self._store.radiance(number)
        return (total / self.repeats).astype(np.float32)

    def shots(self, index: int) -> Sequence[Shot]:
        """Returns the first capture of a picture, as the camera gave it."""
        return self._store.shots(self._first + index * self.repeats)

    @property
    def end(self) -> int:
        """Number of the capture that follows."""
        return self._first + self._count * self.repeats


class Recorder:
    """Numbers the captures, takes the missing ones, and prints how long the rest takes.

    aim : noise allowed in T, used if the store lets pictures be captured repeatedly.
    averaging : how often pictures of the current projector are captured; None means once.
    """

    def __init__(self, camera: Camera, store: Store, aim: Aim, clock: Clock) -> None:
        self._camera, self._store, self._aim, self._clock = camera, store, aim, clock
        self._pace, self._camera_pixels = Pace(len(camera.exposures.times), clock), 0
        self.averaging: Averaging | None = None
        self._pictures, self._count, self._resumed, self._levels = 0, 0, 0, 0
        self._standing: Picture | None = None
        self._said_s = self._clock()
        self._before = 0, 0, 0, self._said_s

    @property
    def coloured(self) -> bool:
        return self._store.coloured

    @property
    def halves(self) -> bool:
        return self._store.halves

    @property
    def averaged(self) -> bool:
        return self._store.averaged

    def includes(self, what: str, number: int, choose: Callable[[], bool]) -> bool:
        """Returns whether to capture pictures: False for captures of older versions, else as in Store."""
        return self._store.includes(what, number, lambda: not self._store.has(self._count) and choose())

    def taken_since(self) -> tuple[int, int, float, int]:
        """Returns pictures, exposures, seconds and resumed captures since the last call."""
        pictures, count, resumed, then = self._before
        self._before = self._pictures, self._count, self._resumed, self._clock()
        exposures = (self._count - count) * len(self._camera.exposures.times)
        return self._pictures - pictures, exposures, self._before[3] - then, self._resumed - resumed

    def capture(self, level: Level, *, repeatedly: bool = False) -> StoredCaptures:
        """Take the missing captures of a level; `repeatedly` captures each picture as often as the noise requires."""
        repeats = self._repeats(level, self.averaging) if repeatedly and self.averaging else 1
        pictures, first = len(level.patterns), self._count
        self._pictures, self._count = self._pictures + pictures, first + pictures * repeats
        shown = LazyPatterns(pictures * repeats, lambda index: level.patterns[index // repeats])
        numbers = range(first, self._count)
        missing = [number for number in numbers if not self._store.has(number)]
        there = len(numbers) - len(missing)
        self._resumed += there
        self._pace.resumed(-(-there // repeats), there)
        start_s = self._clock()
        self._camera.prepare(first, shown, missing)
        waited_s = (self._clock() - start_s) / max(len(missing), 1)
        for number in self._tracked(level, repeats, missing):
            if number == INTRODUCED:
                self._introduce(level)
            self._take(number, shown[number - first], waited_s)
        return StoredCaptures(self._store, first, pictures, repeats)

    def averaging_of(self, once: float) -> Averaging:
        """Returns the averaging of a projector; `once` is the error of T by the noise of single captures."""
        return Averaging(self._aim, once, self._pace, self._aim.seconds - CHECKS_S - computing_s(self._pixels))

    def foretell(self, levels: Sequence[Expected]) -> None:
        """Print how long the acquisition will take; `levels` are all levels that follow."""
        if self.averaging:
            self.averaging.plan(levels)
        self._say("about", levels, 0)

    def _introduce(self, first: Level) -> None:
        """Print the expected duration after the first captures; with averaging, an upper bound (noise is unknown)."""
        if self.averaged:
            self.averaging = self.averaging_of(float("inf"))
            self.averaging.plan([first.expected, *first.later])
        self._say("up to about" if self.averaged else "about", first.later, len(first.patterns))

    def _say(self, about: str, levels: Sequence[Expected], captures: int) -> None:
        """Print the expected duration; `captures` are the missing captures of the present level."""
        if isinstance(self._camera, FolderCamera) and not self._camera.waits:
            return
        whole = self._count + sum(map(self._captures_of, levels))
        pictures = self._pictures + sum(level.pictures for level in levels)
        sizes = [self._store.size(number) for number in range(self._count - captures or INTRODUCED)]
        stored = f", {max(1, round(whole * sum(sizes) / len(sizes) / 1e6))} MB" if any(sizes) else ""
        exposures, left = whole * len(self._camera.exposures.times), duration(self._left_s(levels, captures, captures))
        print(
            f"acquisition: {about} {exposures} exposures of {pictures} pictures, {left}{stored}",
            file=sys.stderr,
            flush=True,
        )

    def _left_s(self, levels: Sequence[Expected], pictures: int, captures: int) -> float:
        """Returns the seconds until the room is ready.

        levels : levels that follow the present one.
        pictures, captures : numbers left in the present level.
        """
        seconds = self._pace.seconds(pictures, captures)
        for level in levels:
            seconds += self._pace.seconds(level.pictures, self._captures_of(level))
        return seconds + max(computing_s(self._pixels) - self._pace.computed_s, 0.0)

    @property
    def _pixels(self) -> int:
        """Pixels of the camera; 0 before the first capture."""
        if not self._camera_pixels and self._store.has(0):
            height, width = self._store.shots(0)[0].shape[:2]
            self._camera_pixels = height * width
        return self._camera_pixels

    def _captures_of(self, expected: Expected) -> int:
        return self.averaging.captures(expected) if self.averaging else expected.pictures

    def _take(self, number: int, picture: Picture, waited_s: float) -> None:
        """Take one capture; `waited_s` is its share of the time in which the camera prepared the level."""
        start_s = self._clock()
        again = self._standing is not None and np.array_equal(picture, self._standing)
        self._store.save(number, self._camera.capture(number, picture))
        self._pace.took(waited_s + self._clock() - start_s, again=again)
        self._standing = picture

    def _repeats(self, level: Level, averaging: Averaging) -> int:
        """Returns the captures per picture of a level; prints them if several."""
        repeats = self._store.repeats(self._levels, lambda: averaging.chosen(level))
        self._levels += 1
        if said := averaging.take(level, repeats):
            print(said, file=sys.stderr, flush=True)
        return repeats

    def _tracked(self, level: Level, repeats: int, missing: Sequence[int]) -> Iterator[int]:
        """Yield `missing` with progress: a bar on a terminal, otherwise an occasional line."""
        bar = progress_bar(level.name, len(missing)) if sys.stderr.isatty() else None
        for done, number in enumerate(missing):
            if bar is not None:
                bar.set_postfix_str(self._left(level, repeats, len(missing) - done))
            elif self._clock() - self._said_s >= LOG_INTERVAL_S:
                self._said_s = self._clock()
                left = self._left(level, repeats, len(missing) - done)
                print(f"{level.name}: {done} of {len(missing)} captures, {left}", file=sys.stderr, flush=True)
            yield number
            if bar is not None:
                bar.update()
        if bar is not None:
            bar.close()

    def _left(self, level: Level, repeats: int, captures: int) -> str:
        return f"about {duration(self._left_s(level.later, -(-captures // repeats), captures))} left"


class Part:
    """Shows one projector's pictures while the others are black, and counts its captures.

    raster : (height, width) of all projectors.
    number : from 1; the first projector's captures include black and all floodlights.
    expected : this projector's levels that follow the first level.
    others : levels of the projectors that follow.
    """

    expected: tuple[Expected, ...] = ()
    others: tuple[Expected, ...] = ()

    def __init__(self, recorder: Recorder, raster: Shape, region: Region, number: int) -> None:
        self._recorder, self._raster, self._region, self.number = recorder, raster, region, number
        self.projector = region.height, region.width

    @property
    def coloured(self) -> bool:
        return self._recorder.coloured

    @property
    def name(self) -> str:
        """Prefix of messages that names the projector; empty if it is the only projector."""
        return "" if self._raster == self.projector else f"projector {self.number}: "

    @property
    def halves(self) -> bool:
        return self._recorder.halves

    @property
    def averaged(self) -> bool:
        return self._recorder.averaged

    def averaging(self, room: Reference, capture: FloatArray) -> Averaging:
        """Returns how often pictures are captured, from a capture of `random_pixels`."""
        return self._recorder.averaging_of(error_by_noise(room, capture))

    def begin(self, averaging: Averaging | None) -> None:
        """Start this projector's turn."""
        self._recorder.averaging = averaging

    def capture(self, level: Level, *, repeatedly: bool = False) -> StoredCaptures:
        """Capture a level in this projector's region; `repeatedly` as in Recorder.capture."""
        level = replace(level, later=(*level.later, *self.others))
        if self._raster == self.projector:
            return self._recorder.capture(level, repeatedly=repeatedly)
        shown = LazyPatterns(len(level.patterns), lambda index: self.in_raster(level.patterns[index]))
        part = replace(level, name=f"{self.name}{level.name}", patterns=shown)
        return self._recorder.capture(part, repeatedly=repeatedly)

    def in_raster(self, picture: Picture) -> Picture:
        return in_raster(picture, self._raster, self._region)

    def includes(self, what: str, choose: Callable[[], bool]) -> bool:
        """Returns whether this projector's captures include such pictures; `choose` decides in the first run."""
        return self._recorder.includes(what, self.number, choose)

    def taken(self) -> tuple[int, int, float, int]:
        """Returns pictures, exposures, seconds and resumed captures since the previous projector's call."""
        return self._recorder.taken_since()


def in_raster(picture: Picture, raster: Shape, region: Region) -> Picture:
    """Returns a projector's picture in its region of the raster, which is black elsewhere."""
    shown = np.zeros((*raster, *picture.shape[2:]), picture.dtype)
    shown[region.part] = picture
    return shown

"""Run a scheme: every pattern in turn, its capture put on disk while the next pattern is shown, and what is checked.

Black and floodlight come first, sixteen times each: black is subtracted from every capture, and how bright each camera
pixel is in all decides how smooth pictures turn out. They also give the noise. A picture and its complement tell
whether the camera is linear. Then ramps, from which the projector's response is measured, and its primaries. Floodlight
comes again at the end, which tells a moved camera, and last random pictures that no scheme has seen, black and white
and coloured: how well they are predicted is the honest measure.

Each of a scheme's pictures is captured once, or as often as the noise asks for (averaging.py).

Several projectors are measured one after the other, the others black; black, which holds the black levels of all, is
captured once.
"""

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol, overload

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import BoolArray, FloatArray
from counterlight.command import LOG_INTERVAL_S, progress_bar
from counterlight.errors import InputError
from counterlight.raster import Region, Shape, side_by_side
from counterlight.response import Response
from counterlight.tools.acquisition.averaging import Aim, Averaged, Averaging, error_by_noise, random_pixels
from counterlight.tools.acquisition.cameras.camera import Camera, Shot
from counterlight.tools.acquisition.check import Check, check_coloured, check_colours, check_pattern, check_white
from counterlight.tools.acquisition.closure import SummedCaptures, check_closure
from counterlight.tools.acquisition.linearity import SHOTS, bends_of, refuse_bends, shown_halves
from counterlight.tools.acquisition.movement import refuse_moved
from counterlight.tools.acquisition.plan import (
    REPEATS,
    LazyPatterns,
    Level,
    MakeScheme,
    Measured,
    Picture,
    Reference,
    Scheme,
    mean_of,
    measure_noise,
)
from counterlight.tools.acquisition.ramps import ProjectorLight, light_level, measure_light

MOST_SATURATED = 0.02  # of the camera's pixels
LEAST_LIT, LEAST_RISE = 0.001, 10  # of the camera's pixels rise by so many times the noise
EXPLAINED = 0.5  # of the coloured check's unexplained error may be left if a white segment is what does not add up
DEFAULT_AIM = Aim()
BLACKS = 8  # captures of black for each of a finest pattern, so that it adds an eighth to their variance
SOME_LEVELS = 7  # that a scheme may have, each of which may take as long as those blacks
AGAIN = "fix them, acquire again with other --captures"


class Store(Protocol):
    """Where captures are kept: on disk (store.py), or in memory.

    halves : a picture and its complement are among them (linearity.py).  coloured : ramps and primaries are.
    averaged : pictures may be captured several times.
    """

    @property
    def halves(self) -> bool: ...
    @property
    def coloured(self) -> bool: ...
    @property
    def averaged(self) -> bool: ...
    def repeats(self, level: int, choose: Callable[[], int]) -> int:
        """Captures of each picture of a level, as they were chosen first; levels are numbered as they come."""

    def has(self, number: int) -> bool: ...
    def save(self, number: int, shots: Sequence[Shot]) -> None: ...
    def shots(self, number: int) -> Sequence[Shot]: ...
    def radiance(self, number: int) -> NDArray[np.float32]: ...


@dataclass(frozen=True)
class Acquisition:
    """What was acquired of a projector.

    light : what the projector makes of code values, None if the captures are of a time when that was not measured.
    pictures, exposures : shown, and photographed for it.  seconds : of this run.  resumed : captures that were there
    already.
    check : of T, by a random pattern.  coloured : of T and the response, by random greys and colours.
    by_measured : the same with the response that was measured, even where another one was given.
    averaged : how often pictures were captured, None if once.
    """

    measured: Measured
    room: Reference
    light: ProjectorLight | None
    pictures: int
    exposures: int
    seconds: float
    resumed: int
    check: Check
    coloured: Check | None
    by_measured: Check | None
    averaged: Averaged | None = None


def acquire(
    camera: Camera,
    store: Store,
    make_scheme: MakeScheme,
    projectors: Sequence[Shape],
    given: Response | None = None,
    aim: Aim = DEFAULT_AIM,
) -> list[Acquisition]:
    """Show, capture and solve for each projector; what is in the store already is not shown again.

    projectors : (height, width) of each; pictures are of the raster of all.  given : their response, where that is not
    to be the measured one.  aim : of the noise that T is to have, where the store lets pictures be averaged.
    Raises InputError for captures that are saturated, black, inconsistent or of another size, and for a moved camera.
    """
    recorder = _Recorder(camera, store)
    shape, regions = side_by_side(projectors)
    parts = [_Part(recorder, shape, region, number) for number, region in enumerate(regions, 1)]
    whites = [part.in_raster(np.ones(part.projector, np.bool_)) for part in parts]
    shown = [np.zeros(shape, np.bool_), *whites] * REPEATS
    halves = len(shown)  # the first capture of those
    if store.halves:
        shown += [part.in_raster(picture) for part in parts for picture in shown_halves(part.projector)]
    captures = recorder.capture(Level("black and floodlight", shown, further=1))
    rooms = [_reference(camera, store, captures, part, len(parts)) for part in parts]
    if store.halves:
        for part, room in zip(parts, rooms, strict=True):
            seen = [capture.astype(np.float64) for capture in captures[halves : halves + 2 * SHOTS]]
            refuse_bends(camera, bends_of(camera, room, mean_of(seen[:SHOTS]), mean_of(seen[SHOTS:])), part.name)
            halves += 2 * SHOTS
    aims = replace(aim, seconds=aim.seconds / len(parts))
    return [_acquire(part, make_scheme, room, given, aims) for part, room in zip(parts, rooms, strict=True)]


def _acquire(part: "_Part", make_scheme: MakeScheme, room: Reference, given: Response | None, aim: Aim) -> Acquisition:
    projector, white = part.projector, np.ones(part.projector, np.bool_)
    light = measure_light(part.capture(light_level(projector)), room) if part.coloured else None
    averaging = None
    if part.averaged:
        averaging = _averaging(part, room, aim)
        room = _with_better_black(part, room, averaging)
    measured = _run(make_scheme(room, projector), part, room, averaging)
    pattern, colours = check_pattern(projector), check_colours(projector)
    shown: list[Picture] = [white, pattern, colours] if light else [white, pattern]
    last = [np.asarray(seen, np.float64) for seen in part.capture(Level("floodlight and check", shown, further=0))]
    before, after = (room.above_black(picture) for picture in (room.floodlight, last[0]))
    refuse_moved(before, after, room.noise, 1 + 1 / REPEATS, AGAIN)
    T, coloured, by_measured = measured.transport, None, None
    if light:
        predicted = partial(check_coloured, room=room, codes=colours, capture=last[2], primaries=light.primaries)
        by_measured = predicted(T, response=light.response)
        if light.segment:
            primary, response = light.without_segment(T, light.segment), replace(light.response, segment=light.segment)
            tried = predicted(primary, response=response)
            if tried.excess < EXPLAINED * by_measured.excess:
                T, light, by_measured = primary, replace(light, response=response), tried
        coloured = predicted(T, response=light.curve(given)) if given else by_measured
    check = check_white(measured.transport, room, pattern, last[1])
    averaged = averaging.done if averaging else None
    measured = replace(measured, transport=T)
    return Acquisition(measured, room, light, *part.taken(), check, coloured, by_measured, averaged)


def _averaging(part: "_Part", room: Reference, aim: Aim) -> Averaging:
    (seen,) = part.capture(Level("noise", [random_pixels(part.projector)], further=1))
    averaging = Averaging(aim, error_by_noise(room, np.asarray(seen, np.float64)))
    print(f"{part.name}{averaging}", file=sys.stderr, flush=True)
    return averaging


def _with_better_black(part: "_Part", room: Reference, averaging: Averaging) -> Reference:
    """Black is subtracted from every capture, so that its noise must be below that of their means.

    With 16 captures of black beside 62 of each pattern its noise passed for light that all blocks give.
    """
    if BLACKS * averaging.wanted <= REPEATS:
        return room
    black = np.zeros(part.projector, np.bool_)
    more = part.capture(Level("black", [black] * BLACKS, further=SOME_LEVELS, share=1), averaging)
    total, count = REPEATS * room.black, REPEATS + BLACKS * more.repeats
    for seen in more:
        total = total + more.repeats * np.asarray(seen, np.float64)
    return replace(room, black=total / count)


def _run(scheme: Scheme, part: "_Part", room: Reference, averaging: Averaging | None) -> Measured:
    """Give a scheme the captures that it asks for."""
    level = next(scheme)
    while True:
        captures = SummedCaptures(part.capture(level, averaging))
        try:
            following = scheme.send(captures)
        except StopIteration as ended:
            check_closure(level, captures, room)
            measured: Measured = ended.value
            return measured
        except InputError:
            check_closure(level, captures, room)  # what a wrong capture leads to says less than that it is wrong
            raise
        check_closure(level, captures, room)
        level = following


class _StoredCaptures(Sequence[NDArray[np.float32]]):
    """Radiance of pictures, read when it is asked for.

    first : number of the first one's first capture.  count : of pictures.  repeats : captures of each.
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


class _Recorder:
    """Numbers the captures and takes those that are missing."""

    def __init__(self, camera: Camera, store: Store) -> None:
        self._camera, self._store = camera, store
        self.pictures, self.count, self.resumed, self.start = 0, 0, 0, time.monotonic()
        self._taken, self._levels, self._before = 0, 0, (0, 0, 0, self.start)

    @property
    def coloured(self) -> bool:
        return self._store.coloured

    @property
    def averaged(self) -> bool:
        return self._store.averaged

    @property
    def each_s(self) -> float | None:
        """Seconds of a capture, None before the first."""
        return (time.monotonic() - self.start) / self._taken if self._taken else None

    def taken_since(self) -> tuple[int, int, float, int]:
        """Pictures, exposures, seconds and resumed captures since this was last asked."""
        pictures, count, resumed, then = self._before
        self._before = self.pictures, self.count, self.resumed, time.monotonic()
        exposures = (self.count - count) * len(self._camera.exposures.times)
        return self.pictures - pictures, exposures, self._before[3] - then, self.resumed - resumed

    def capture(self, level: Level, averaging: Averaging | None = None) -> _StoredCaptures:
        repeats = 1 if averaging is None else self._repeats(level, averaging)
        pictures, first = len(level.patterns), self.count
        self.pictures, self.count = self.pictures + pictures, first + pictures * repeats
        shown = LazyPatterns(pictures * repeats, lambda index: level.patterns[index // repeats])
        numbers = range(first, self.count)
        missing = [number for number in numbers if not self._store.has(number)]
        self.resumed += len(numbers) - len(missing)
        self._camera.prepare(first, shown, missing)
        for number in self._told(level, missing):
            self._store.save(number, self._camera.capture(number, shown[number - first]))
            self._taken += 1
        return _StoredCaptures(self._store, first, pictures, repeats)

    def _repeats(self, level: Level, averaging: Averaging) -> int:
        """Captures of each of a level's pictures; said where there are several."""
        repeats = self._store.repeats(self._levels, lambda: averaging.chosen(level, self.each_s))
        self._levels += 1
        if said := averaging.take(level, repeats, self.each_s):
            print(said, file=sys.stderr, flush=True)
        return repeats

    def _told(self, level: Level, missing: Sequence[int]) -> Iterator[int]:
        """Yield `missing` with progress: a bar on a terminal, otherwise a line now and then."""
        bar = progress_bar(level.name, len(missing)) if sys.stderr.isatty() else None
        said = time.monotonic()
        for done, number in enumerate(missing):
            left = self._remaining(level, len(missing) - done)
            if bar is not None:
                bar.set_postfix_str(left)
            elif time.monotonic() - said >= LOG_INTERVAL_S:
                said = time.monotonic()
                print(f"{level.name}: {done} of {len(missing)} captures, {left}", file=sys.stderr)
            yield number
            if bar is not None:
                bar.update()
        if bar is not None:
            bar.close()

    def _remaining(self, level: Level, captures: int) -> str:
        """Seconds for this level, whose captures are counted, and for the others, whose number nobody knows yet."""
        each = self.each_s
        if each is None:
            return "no time known yet"
        later = level.further * len(level.patterns)
        more = f"; {each * later:.0f} s more if each further level ({level.further}) takes as many" if later else ""
        return f"{each:.2g} s each, {each * captures:.0f} s left in this level{more}"


class _Part:
    """Shows one projector's pictures, the others black, and counts what was captured for it.

    raster : (height, width) of all.  number : from 1; the first one's captures are also those of black and floodlights.
    """

    def __init__(self, recorder: "_Recorder", raster: Shape, region: Region, number: int) -> None:
        self._recorder, self._raster, self._region, self.number = recorder, raster, region, number
        self.projector = region.height, region.width

    @property
    def coloured(self) -> bool:
        return self._recorder.coloured

    @property
    def name(self) -> str:
        """Before what is said of it, if it is not the only one."""
        return "" if self._raster == self.projector else f"projector {self.number}: "

    @property
    def averaged(self) -> bool:
        return self._recorder.averaged

    def capture(self, level: Level, averaging: Averaging | None = None) -> _StoredCaptures:
        if self._raster == self.projector:
            return self._recorder.capture(level, averaging)
        shown = LazyPatterns(len(level.patterns), lambda index: self.in_raster(level.patterns[index]))
        part = replace(level, name=f"{self.name}{level.name}", patterns=shown)
        return self._recorder.capture(part, averaging)

    def in_raster(self, picture: Picture) -> Picture:
        shown = np.zeros((*self._raster, *picture.shape[2:]), picture.dtype)
        shown[self._region.part] = picture
        return shown

    def taken(self) -> tuple[int, int, float, int]:
        """Pictures, exposures, seconds and resumed captures since the part before had its own."""
        return self._recorder.taken_since()


def _reference(
    camera: Camera, store: Store, captures: Sequence[NDArray[np.float32]], part: _Part, parts: int
) -> Reference:
    black, white = (LazyPatterns(REPEATS, partial(_every, captures, first, parts + 1)) for first in (0, part.number))
    saturated = camera.exposures.saturated(store.shots(part.number)) | camera.exposures.saturated(store.shots(0))
    noise = measure_noise(black, white)
    room = Reference(mean_of(black), mean_of(white), noise, saturated, REPEATS)
    refuse_unusable(room, part.name)
    return room


def _every(captures: Sequence[NDArray[np.float32]], first: int, apart: int, index: int) -> FloatArray:
    return captures[first + index * apart].astype(np.float64)


def refuse_unusable(room: Reference, name: str = "") -> None:
    """InputError for a room of which too much saturates, or that the projector hardly lights.

    name : of the projector, before what is said.
    """
    if room.saturated.mean() > MOST_SATURATED:
        raise InputError(
            f"{name}the floodlit room saturates {100 * room.saturated.mean():.0f} % of the camera's pixels, at most "
            f"{100 * MOST_SATURATED:.0f} % may be; shorten the exposure (or add a shorter one) and capture again"
        )
    if not rises(room):
        lit = _clearly_lit(room)
        raise InputError(
            f"{name}from black to floodlight {int(lit.sum())} of {lit.size} camera pixels rise clearly above the "
            "noise; check that the projector is on, that the camera sees it, and that the exposure is long enough"
        )


def rises(room: Reference) -> bool:
    """Whether enough camera pixels do, from black to floodlight."""
    return bool(_clearly_lit(room).mean() >= LEAST_LIT)


def _clearly_lit(room: Reference) -> BoolArray:
    return np.asarray(np.any((room.light > 0) & (room.light >= LEAST_RISE * room.noise.dark), axis=1))

"""Run a scheme: show every pattern, save each capture while the next pattern is shown, and check the result.

1. Black and floodlight, 16 captures each. Black is subtracted from every capture. Both give the noise, and the
   floodlight decides how smooth pictures turn out.
2. A picture and its complement, which show whether the camera is linear. If it may have a curve, more pictures measure
   the curve (curve.py), and all captures are read with it.
3. Ramps, which give the projector's response and its primaries.
4. The scheme's pictures. Each is captured once, or as often as the noise requires (averaging.py).
5. Floodlight again, which reveals a moved camera.
6. Random pictures, black-and-white and coloured, that no scheme has seen. Their prediction error is the honest measure.
7. Full pictures of colours, where red, green and blue do not add up to grey (processing.py).
8. Compensated pictures, where the camera's files have 8 bits. The room's interval is fitted to them.

Several projectors are measured one after the other, while the others show black. Black contains the black levels of
all projectors and is captured once.
"""

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import BoolArray, FloatArray
from counterlight.errors import InputError
from counterlight.raster import Shape, side_by_side
from counterlight.response import Response
from counterlight.tools.acquisition.averaging import Aim, Averaged, Averaging, random_pixels
from counterlight.tools.acquisition.camera_shift import refuse_moved
from counterlight.tools.acquisition.cameras.camera import Camera
from counterlight.tools.acquisition.check import (
    Check,
    check_coloured,
    check_colours,
    check_pattern,
    check_photographs,
    check_white,
)
from counterlight.tools.acquisition.closure import SummedCaptures, check_closure
from counterlight.tools.acquisition.coarse_colour import coloured_like_white
from counterlight.tools.acquisition.curve import CURVE_PICTURES, Curve, curve_of, curve_pictures
from counterlight.tools.acquisition.linearity import SHOTS, Bend, bends_of, refuse_bends, shown_halves
from counterlight.tools.acquisition.pace import Clock
from counterlight.tools.acquisition.plan import (
    REPEATS,
    Expected,
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
from counterlight.tools.acquisition.processing import colour_level, measure_processing
from counterlight.tools.acquisition.ramps import ProjectorLight, light_level, measure_light
from counterlight.tools.acquisition.recording import Part, Recorder, Store, StoredCaptures
from counterlight.tools.acquisition.wander import Wander, wander_of

MOST_SATURATED = 0.02  # largest share of the camera's pixels that may be saturated
# least share of the camera's pixels that must rise; least rise in multiples of the noise
LEAST_LIT, LEAST_RISE = 0.001, 10
EXPLAINED = 0.5  # a white segment must reduce the unexplained error of the coloured check to at most this share
LESS = 0.8  # same share for colour processing, whose error includes the gains of a camera without a border
DEFAULT_AIM = Aim()
BLACKS = 8  # captures of black per capture of a finest pattern, so that black adds an eighth to their variance
LAST = Expected(3)  # floodlight and the two checks
AGAIN = "fix them, acquire again with other --captures"


@dataclass(frozen=True)
class Acquisition:
    """The measurements of one projector.

    light : light per code value; None if the captures come from a version that did not measure it.
    pictures : number of pictures shown.
    exposures : number of photographs.
    seconds : duration of this run.
    resumed : number of captures that were already in the store.
    check : test of T by a random pattern.
    coloured : test of T and the response by random greys and colours.
    by_measured : like `coloured`, with the measured response even if another response was given.
    averaged : how often pictures were captured; None if once.
    curve : measured curve of the camera; None if the curve was given or the camera is linear.
    wander : gains of the camera's captures; None if they were not looked at.
    photographs : tests of all by compensated pictures, if the camera's files have 8 bits.
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
    curve: Curve | None = None
    wander: Wander | None = None
    photographs: tuple[Check, ...] = ()

    @property
    def of_colours(self) -> Check | None:
        """The test of T, response and primaries: the worse compensated picture, or `coloured` without any."""
        return max(self.photographs, key=lambda check: check.error, default=self.coloured)


def acquire(
    camera: Camera,
    store: Store,
    make_scheme: MakeScheme,
    projectors: Sequence[Shape],
    given: Response | None = None,
    aim: Aim = DEFAULT_AIM,
    clock: Clock = time.monotonic,
) -> list[Acquisition]:
    """Show, capture and solve for each projector; pictures whose captures are in the store are not shown again.

    projectors : (height, width) of each; the pictures cover the raster of all projectors.
    given : the projectors' response, if it replaces the measured response.
    aim : noise allowed in T, used if the store lets pictures be averaged.
    clock : seconds; used to estimate the remaining time.

    Raises InputError for captures that are saturated, black, inconsistent or of another size, and for a moved camera.
    """
    recorder = Recorder(camera, store, aim, clock)
    raster, regions = side_by_side(projectors)
    parts = [Part(recorder, raster, region, number) for number, region in enumerate(regions, 1)]
    expected = [_expected(part, make_scheme) for part in parts]
    for number, part in enumerate(parts, 1):
        part.expected, part.others = expected[number - 1], tuple(chain(*expected[number:]))
    whites = [part.in_raster(np.ones(part.projector, np.bool_)) for part in parts]
    shown = [np.zeros(raster, np.bool_), *whites] * REPEATS
    first, early = len(shown), [[part.in_raster(each) for each in _early_pictures(part)] for part in parts]
    later = tuple(chain(*expected))
    captures = recorder.capture(Level("black and floodlight", [*shown, *chain(*early)], later))
    curve = _measured_curve(camera, store, captures, parts[0], (first, len(parts)))
    rooms = [_reference(camera, store, captures, part, len(parts)) for part in parts]
    wanders = [
        wander_of(room, *(_repeated(captures, first, len(parts)) for first in (0, part.number)))
        for part, room in zip(parts, rooms, strict=True)
    ]
    averagings = list[Averaging | None]()
    for part, wander, pictures in zip(parts, wanders, early, strict=True):
        room = wander.room
        seen = [capture.astype(np.float64) for capture in captures[first : first + len(pictures)]]
        first += len(pictures)
        if seen:
            refuse_bends(camera, _bends(camera, room, seen), part.name, measured=curve is not None)
        averagings.append(part.averaging(room, seen[-1]) if seen and part.averaged else None)
    recorder.averaging, coarse = averagings[0], captures.shots(0)[0].dtype == np.uint8
    recorder.foretell(later)
    return [
        replace(_acquire(part, make_scheme, wander, given, averaging, coarse=coarse), curve=curve, wander=wander)
        for part, wander, averaging in zip(parts, wanders, averagings, strict=True)
    ]


def _bends(camera: Camera, room: Reference, seen: Sequence[FloatArray]) -> list[Bend | None]:
    """Returns the bend of each camera (linearity.py); `seen` begins with the captures of `shown_halves`."""
    return bends_of(camera, room, mean_of(seen[:SHOTS]), mean_of(seen[SHOTS : 2 * SHOTS]))


def _measured_curve(
    camera: Camera, store: Store, captures: StoredCaptures, part: Part, halves: tuple[int, int]
) -> Curve | None:
    """Measure the camera's curve with the first projector, and read all captures with it; None if it is not needed.

    halves : index of the first projector's first half, and the number of projectors.
    """
    first, parts = halves

    def wanted() -> bool:
        if camera.exposures.known or not part.halves or store.has(captures.end):
            return False
        if captures.shots(0)[0].dtype == np.uint8:
            return True
        room = _reference(camera, store, captures, part, parts)
        bends = _bends(camera, room, [each.astype(np.float64) for each in captures[first : first + 2 * SHOTS]])
        return any(bend is not None and bend.is_suspect for bend in bends)

    if not store.has_curve(wanted):
        return None
    if not store.has(captures.end):
        print(f"the camera may have a curve: {CURVE_PICTURES} more pictures measure it", file=sys.stderr, flush=True)
    seen = part.capture(Level("the camera's curve", curve_pictures(part.projector), part.expected))
    if camera.exposures.known:
        return None
    black, white, again = (captures.shots(number) for number in (0, part.number, part.number + parts + 1))
    found = curve_of([black, white, *(seen.shots(i) for i in range(len(seen)))], camera.exposures, again)
    store.develop(found.response)
    return found


def _early_pictures(part: Part) -> list[Picture]:
    """Pictures shown with black and floodlight: they test whether the camera is linear and how noise affects T."""
    if not part.halves:
        return []
    return [*shown_halves(part.projector), *([random_pixels(part.projector)] if part.averaged else [])]


def _expected(part: Part, make_scheme: MakeScheme) -> tuple[Expected, ...]:
    """Returns the levels that follow a projector's first level."""
    light = len(light_level(part.projector).patterns) if part.coloured else 0
    black = BLACKS if part.averaged else 0
    return Expected(light), Expected(black, share=1), *make_scheme.expected(part.projector), LAST


def _acquire(
    part: Part, make_scheme: MakeScheme, wander: Wander, given: Response | None, averaging: Averaging | None,
    *, coarse: bool,
) -> Acquisition:  # fmt: skip
    """Measure one projector.

    averaging : None if the store has no captures to plan it from.
    coarse : whether the camera's files have 8 bits. JPEG damages random pictures more than compensated pictures.
    """
    projector, white, room = part.projector, np.ones(part.projector, np.bool_), wander.room
    part.begin(averaging)
    light = None
    if part.coloured:
        ramps = part.capture(replace(light_level(projector), later=part.expected[1:]))
        light = measure_light(wander.steadied(ramps), room, wander.left)
    if part.averaged:
        if averaging is None:  # captures of an older version have the random picture here
            (seen,) = part.capture(Level("noise", [random_pixels(projector)], part.expected[1:]))
            averaging = part.averaging(room, np.asarray(seen, np.float64))
            part.begin(averaging)
        room = _with_better_black(part, room, averaging)
    wander = replace(wander, room=room)
    measured = _run(make_scheme(room, projector), part, wander)
    if coarse:
        measured = replace(measured, transport=coloured_like_white(measured.transport, room))
    pattern, colours = check_pattern(projector), check_colours(projector)
    shown: list[Picture] = [white, pattern, colours] if light else [white, pattern]
    checked = part.capture(Level("floodlight and check", shown))
    last = [np.asarray(seen, np.float64) for seen in checked]
    before, after = (room.above_black(picture) for picture in (room.floodlight, wander.steadied(checked)[0]))
    refuse_moved(before, after, room.noise, 1 + 1 / REPEATS, AGAIN)
    T, coloured, by_measured, photographs = measured.transport, None, None, tuple[Check, ...]()
    if light:
        predicted = partial(check_coloured, room=room, codes=colours, capture=last[2], wandering=wander.is_active)
        by_measured = predicted(T, response=light.response, primaries=light.primaries)
        if light.segment:
            primary, response = light.without_segment(T, light.segment), replace(light.response, segment=light.segment)
            tried = predicted(primary, response=response, primaries=light.primaries)
            if tried.excess < EXPLAINED * by_measured.excess:
                T, light, by_measured = primary, replace(light, response=response), tried
        if not light.is_explained and part.includes("colours", lambda: True):
            processed = _with_processing(part, wander, light)
            tried = predicted(T, response=processed.response, primaries=processed.primaries)
            if tried.excess < LESS * by_measured.excess:
                light, by_measured = processed, tried
        believed = light.curve(given) if given else light.response
        judged = partial(predicted, T, response=believed, primaries=light.primaries)
        coloured = judged() if given else by_measured
        if coarse and part.includes("photographs", lambda: True):
            pictures: list[Picture] = [*check_photographs(T, room, believed, projector)]
            taken = part.capture(Level("photographs", pictures))
            photographs = tuple(
                replace(judged(codes=codes, capture=np.asarray(seen, np.float64)), of="compensated pictures")
                for codes, seen in zip(pictures, taken, strict=True)
            )
    check = check_white(measured.transport, room, pattern, last[1], wandering=wander.is_active)
    averaged = averaging.done if averaging else None
    measured = replace(measured, transport=T)
    found = Acquisition(measured, room, light, *part.taken(), check, coloured, by_measured, averaged)
    return replace(found, photographs=photographs)


def _with_processing(part: Part, wander: Wander, light: ProjectorLight) -> ProjectorLight:
    """Measure the projector's colour processing."""
    level = colour_level(part.projector)
    print(
        f"colours do not add up to grey: {len(level.patterns)} more pictures measure them", file=sys.stderr, flush=True
    )
    seen = wander.steadied(part.capture(level))
    processing, primaries = measure_processing(seen, wander.room, light, wander.left)
    return replace(light, response=replace(light.response, processing=processing), primaries=primaries)


def _with_better_black(part: Part, room: Reference, averaging: Averaging) -> Reference:
    """Capture more black, because its noise must stay below the noise of the averaged captures.

    With 16 captures of black and 62 captures of each pattern, the noise of black looked like light from all blocks.
    """
    if BLACKS * averaging.wanted <= REPEATS:
        return room
    black = np.zeros(part.projector, np.bool_)
    more = part.capture(Level("black", [black] * BLACKS, part.expected[2:], share=1), repeatedly=True)
    total, count = REPEATS * room.black, REPEATS + BLACKS * more.repeats
    for seen in more:
        total = total + more.repeats * np.asarray(seen, np.float64)
    return replace(room, black=total / count)


def _run(scheme: Scheme, part: Part, wander: Wander) -> Measured:
    """Drive a scheme: capture each level that it yields, check the level, and return what it measured."""
    level, room = next(scheme), wander.room
    while True:
        captured = part.capture(replace(level, later=(*level.later, LAST)), repeatedly=True)
        captures = SummedCaptures(wander.closed(captured, level.cover))
        try:
            following = scheme.send(captures)
        except StopIteration as ended:
            check_closure(level, captures, room)
            measured: Measured = ended.value
            return measured
        except InputError:
            # for a wrong capture, this check's message is more precise than the scheme's error
            check_closure(level, captures, room)
            raise
        check_closure(level, captures, room)
        level = following


def _reference(
    camera: Camera, store: Store, captures: Sequence[NDArray[np.float32]], part: Part, parts: int
) -> Reference:
    black, white = (_repeated(captures, first, parts) for first in (0, part.number))
    saturated = camera.exposures.saturated(store.shots(part.number)) | camera.exposures.saturated(store.shots(0))
    noise = measure_noise(black, white)
    room = Reference(mean_of(black), mean_of(white), noise, saturated, REPEATS)
    refuse_unusable(room, part.name)
    return room


def _repeated(captures: Sequence[NDArray[np.float32]], first: int, parts: int) -> LazyPatterns[FloatArray]:
    """Returns the captures of black (first = 0), or of a projector's white (its number)."""
    return LazyPatterns(REPEATS, partial(_every, captures, first, parts + 1))


def _every(captures: Sequence[NDArray[np.float32]], first: int, apart: int, index: int) -> FloatArray:
    return captures[first + index * apart].astype(np.float64)


def refuse_unusable(room: Reference, name: str = "") -> None:
    """Raises InputError for a room that saturates too many pixels, or that the projector hardly lights.

    name : prefix of the message that names the projector.
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
    """Whether enough camera pixels rise from black to floodlight."""
    return bool(_clearly_lit(room).mean() >= LEAST_LIT)


def _clearly_lit(room: Reference) -> BoolArray:
    return np.asarray(np.any((room.light > 0) & (room.light >= LEAST_RISE * room.noise.dark), axis=1))

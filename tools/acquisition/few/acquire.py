"""Show the most important pictures first, until the requested number is reached or the user stops; make a room.

The number includes all pictures: black, primaries, pictures that give places, and pictures that test the room. A camera
that may have a curve takes the pictures of curve.py in addition, under numbers of their own. Several
projectors take turns, so that all have equally many pictures at any time. Several cameras photograph each picture.
"""

import sys
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from counterlight import memory
from counterlight.command import track
from counterlight.errors import InputError
from counterlight.raster import Shape, Shapes, side_by_side
from counterlight.response import Response
from counterlight.tools.acquisition.acquire import Acquisition
from counterlight.tools.acquisition.cameras.camera import Camera
from counterlight.tools.acquisition.cameras.folder import Waiting
from counterlight.tools.acquisition.cameras.together import views_of
from counterlight.tools.acquisition.curve import Curve, curve_of, curve_pictures
from counterlight.tools.acquisition.few.order import BLACK, Order, Turns
from counterlight.tools.acquisition.few.views import Views, views_fitted
from counterlight.tools.acquisition.linearity import refuse_bends
from counterlight.tools.acquisition.plan import Measured
from counterlight.tools.acquisition.recording import Store, in_raster

FIRST_OF_CURVE = 1 << 13  # number of the first picture of the camera's curve, above all others
COPIES = 3  # copies of all captures (float32) that are in memory at the same time


def acquire_pictures(
    camera: Camera,
    store: Store,
    count: int,
    projectors: Sequence[Shape],
    given: Response | None = None,
    *,
    stoppable: bool = True,
) -> list[Acquisition]:
    """Show, capture and fit for each projector; pictures whose captures are in the store are not shown again.

    count : number of pictures in total.
    projectors : (height, width) of each.
    given : the projectors' response, if it replaces the measured response.
    stoppable : once there are enough pictures, an interruption ends the showing, and the room is made of them.

    Raises InputError for too few pictures, captures that are saturated or black, a moved camera, and a camera that
    random pictures show to be non-linear.
    """
    check_count(count, projectors)
    turns, start = Turns(tuple(projectors)), time.monotonic()
    count = turns.in_all(turns.of_each(count))
    before = [number for number in range(count) if store.has(number)]
    of_each = turns.of_each(_captured(camera, store, turns, count, stoppable))

    names = [f"projector {number}: " if len(projectors) > 1 else "" for number in range(1, len(projectors) + 1)]

    def fitted(number: int) -> Views:
        return _views(camera, store, turns.orders[number], turns.numbers(number, of_each), given, names[number])

    curve, first = None, None
    if not camera.exposures.known:
        if store.shots(BLACK)[0].dtype != np.uint8:
            first = fitted(0)
        if first is None or any(view.bend is not None and view.bend.is_suspect for view in first.views):
            curve, first = _measured_curve(camera, store, turns.projectors), None
    seconds, found = (time.monotonic() - start) / len(projectors), []
    for projector, order in enumerate(turns.orders):
        numbers = turns.numbers(projector, of_each)
        views = fitted(projector) if projector or first is None else first
        for view in views.views:
            refuse_bends(camera, [view.bend], f"{names[projector]}{view.name}", measured=curve is not None)
        own = numbers[projector > 0 :]  # only the first projector's captures include black
        resumed = len(set(own) & set(before))
        done = _acquisition(camera, views, order, of_each, len(own), seconds, resumed)
        found.append(replace(done, curve=curve))
    return found


def _measured_curve(camera: Camera, store: Store, projectors: Shapes) -> Curve:
    """Capture the pictures of the camera's curve with the first projector, and read all captures with the curve."""
    raster, regions = side_by_side(projectors)
    own = [np.ones(projectors[0], np.bool_), *curve_pictures(projectors[0])]
    pictures = [in_raster(each, raster, regions[0]) for each in own]
    numbers = range(FIRST_OF_CURVE, FIRST_OF_CURVE + len(pictures))
    missing = [number for number in numbers if not store.has(number)]
    if missing:
        print(f"the camera may have a curve: {len(missing)} more pictures measure it", file=sys.stderr, flush=True)
    camera.prepare(FIRST_OF_CURVE, pictures, missing)
    for number in track(missing, "the camera's curve"):
        store.save(number, camera.capture(number, pictures[number - FIRST_OF_CURVE]))
    found = curve_of([store.shots(number) for number in (BLACK, *numbers)], camera.exposures)
    store.develop(found.response)
    return found


def check_count(count: int, projectors: Sequence[Shape]) -> None:
    """Raises InputError, before anything is shown, for too few pictures to find places."""
    turns = Turns(tuple(projectors))
    if count >= turns.least:
        return
    sizes = " and ".join(f"{width}x{height}" for height, width in projectors)
    who = f"a projector of {sizes} needs" if len(projectors) == 1 else f"projectors of {sizes} need"
    raise InputError(f"--pictures {count}: {who} {turns.least} or more, black and primaries among them")


def _acquisition(
    camera: Camera, views: Views, order: Order, of_each: int, pictures: int, seconds: float, resumed: int
) -> Acquisition:
    return Acquisition(
        measured=Measured(views.transport, (_note(order, of_each), *map(str, views.views))),
        room=views.room,
        light=views.light,
        pictures=pictures,
        exposures=pictures * len(camera.exposures.times),
        seconds=seconds,
        resumed=resumed,
        check=views.check,
        coloured=None,
        by_measured=None,
        wander=views.wander,
    )


def _note(order: Order, count: int) -> str:
    whites, random = len(order.whites(count)), len(order.random(count))
    return f"{count} pictures in all: {order.least} for places and colours, {whites} white, {random} random"


def _captured(camera: Camera, store: Store, turns: Turns, count: int, stoppable: bool) -> int:
    """Capture the missing pictures; returns how many pictures exist in the end."""
    pictures = turns.pictures(count)
    missing = [number for number in range(count) if not store.has(number)]
    there = missing
    try:
        camera.prepare(0, pictures, missing)
    except Waiting as waiting:
        if waiting.first < turns.least:
            raise
        if not waiting.waited:
            raise InputError(
                f"{waiting}; or make the room of those that are there: --pictures {waiting.first}"
            ) from None
        there = [number for number in missing if number < waiting.first]
    try:
        for number in track(there, "pictures"):
            store.save(number, camera.capture(number, pictures[number]))
    except KeyboardInterrupt:
        if not stoppable or _first_missing(store, count) < turns.least:
            raise
    found = _first_missing(store, count)
    if found < count:
        print(f"stopped after {found} of {count} pictures; the room is made of these", file=sys.stderr, flush=True)
    return found


def _first_missing(store: Store, count: int) -> int:
    return next((number for number in range(count) if not store.has(number)), count)


def _views(camera: Camera, store: Store, order: Order, numbers: list[int], given: Response | None, name: str) -> Views:
    """Fit all cameras' captures of one projector."""
    captures, saturated = [], np.zeros((1, 1), np.bool_)
    for number in numbers:
        shots = store.shots(number)
        if number == 0:
            remedy = "ask for fewer --pictures, or let the camera give smaller ones"
            needed = COPIES * len(numbers) * 12 * shots[0].shape[0] * shots[0].shape[1]
            memory.check(needed, f"{len(numbers)} pictures", remedy)
        saturated = saturated | camera.exposures.saturated(shots)
        captures.append(store.radiance(number))
    return views_fitted(order, captures, saturated, views_of(camera), given, name)

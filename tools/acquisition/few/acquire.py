"""Show the most important pictures first until there are as many as asked for, or somebody says stop; make a room.

All of it counts: black, primaries, places and what says how good the room is are among the pictures asked for.
"""

import sys
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from counterlight import memory
from counterlight.command import track
from counterlight.errors import InputError
from counterlight.raster import Shape
from counterlight.response import Response
from counterlight.tools.acquisition.acquire import AGAIN, Acquisition, Store, refuse_unusable
from counterlight.tools.acquisition.cameras.camera import Camera
from counterlight.tools.acquisition.cameras.folder import Waiting
from counterlight.tools.acquisition.cameras.together import are_several
from counterlight.tools.acquisition.few.fitting import Fit, fitted
from counterlight.tools.acquisition.few.held_out import RAMPS_ALONE, check_ramps, held_out
from counterlight.tools.acquisition.few.order import Order
from counterlight.tools.acquisition.few.reference import noise_by_neighbours, reference
from counterlight.tools.acquisition.few.response import Curves, curves_of
from counterlight.tools.acquisition.few.seen import SUMMED, Seen
from counterlight.tools.acquisition.movement import refuse_moved
from counterlight.tools.acquisition.plan import Measured
from counterlight.tools.acquisition.ramps import CODES, ProjectorLight, crosstalk

COPIES = 3  # of all captures, float32, that are in memory at once


def acquire_pictures(
    camera: Camera, store: Store, count: int, projector: tuple[int, int], given: Response | None = None
) -> Acquisition:
    """Show, capture and fit; what is in the store already is not shown again.

    count : of all pictures.  projector : (height, width).  given : its response, where that is not to be the measured
    one. An interruption ends the showing, as soon as there are enough; then the room is of those that there are.
    Raises InputError for captures that are saturated or black, and for a moved camera.
    """
    order, start = Order(projector), time.monotonic()
    count, resumed = _captured(camera, store, order, count)
    seen = _seen(camera, store, order, count)
    seconds, random = time.monotonic() - start, order.random(count)
    curves, spots = curves_of(seen, given)
    fit = fitted(seen, curves.table, spots, random)
    held = held_out(seen, curves.table, spots, random)
    said = RAMPS_ALONE if held is None else str(held)
    return Acquisition(
        measured=Measured(fit.transport, (_note(order, count), said)),
        room=seen.room,
        light=_light(fit, curves),
        pictures=count,
        exposures=count * len(camera.exposures.times),
        seconds=seconds,
        resumed=resumed,
        check=check_ramps(fit) if held is None else held.check,
        coloured=None,
        by_measured=None,
    )


def check_asked(camera: Camera, count: int, projectors: Sequence[Shape]) -> None:
    """InputError, before anything is shown, for several of either, and for too few pictures to tell where one looks."""
    if len(projectors) > 1:
        raise InputError(
            f"--pictures {count}: of one projector; leave it out, or acquire with each by itself, then: "
            "counterlight join"
        )
    projector = projectors[0]
    if are_several(camera):
        raise InputError(
            f"--pictures {count}: of one camera; leave it out, or acquire with each camera by itself, then: "
            "counterlight join --cameras"
        )
    least = Order(projector).least
    if count < least:
        raise InputError(
            f"--pictures {count}: a projector of {projector[1]}x{projector[0]} needs {least} or more, black and "
            "primaries among them"
        )


def _note(order: Order, count: int) -> str:
    whites, random = len(order.whites(count)), len(order.random(count))
    return f"{count} pictures in all: {order.least} for places and colours, {whites} white, {random} random"


def _captured(camera: Camera, store: Store, order: Order, count: int) -> tuple[int, int]:
    """How many pictures there are in the end, and how many there were before."""
    pictures = order.pictures(count)
    missing = [number for number in range(count) if not store.has(number)]
    there = missing
    try:
        camera.prepare(0, pictures, missing)
    except Waiting as waiting:
        if waiting.first < order.least:
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
        if _first_missing(store, count) < order.least:
            raise
    found = _first_missing(store, count)
    if found < count:
        print(f"stopped after {found} of {count} pictures; the room is made of these", file=sys.stderr, flush=True)
    return found, min(found, count - len(missing))


def _first_missing(store: Store, count: int) -> int:
    return next((number for number in range(count) if not store.has(number)), count)


def _seen(camera: Camera, store: Store, order: Order, count: int) -> Seen:
    captures, saturated = [], np.zeros((1, 1), np.bool_)
    for number in range(count):
        shots = store.shots(number)
        if number == 0:
            remedy = "ask for fewer --pictures, or let the camera give smaller ones"
            memory.check(COPIES * count * 12 * shots[0].shape[0] * shots[0].shape[1], f"{count} pictures", remedy)
        saturated = saturated | camera.exposures.saturated(shots)
        captures.append(camera.exposures.radiance(shots))
    seen = reference(order, captures, saturated)
    noise = noise_by_neighbours(seen.room)
    refuse_unusable(replace(seen.room, noise=replace(noise, dark=SUMMED * noise.dark)))
    whites = order.whites(count)
    for later in whites[1:]:
        before, after = (seen.above[number].astype(np.float64) for number in (whites[0], later))
        refuse_moved(before, after, seen.room.noise, 2, AGAIN)
    return seen


def _light(fit: Fit, curves: Curves) -> ProjectorLight:
    """The primaries, the response, and whether white is their sum."""
    seen, (height, width) = fit.seen, fit.seen.camera
    unadded, whites = np.zeros(len(CODES)), seen.order.whites(seen.count)
    if whites:
        weights = np.where(seen.clarity > 0, seen.light, 0)
        beside = seen.above[whites[0]] - seen.primaries.sum(axis=2)
        unadded[-1] = float(np.vdot(weights, beside) / np.vdot(weights, seen.light))
    primaries = fit.primaries.transpose(2, 0, 1)
    return ProjectorLight(
        response=curves.response,
        gammas=curves.gammas,
        primaries=primaries.reshape(3, height, width, 3).astype(np.float32),
        fitted=curves.pooled,
        noise=curves.noise,
        unadded=unadded,
        unadded_noise=4 / float(np.sqrt(max(seen.clarity.sum(), 1.0))),
        segment=None,
        crosstalk=crosstalk(primaries, seen.room),
    )

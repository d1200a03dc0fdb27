"""Fit the captures of one projector's pictures camera by camera, and combine the fits.

Neighbourhoods and noise are evaluated per camera. The projector has one response, measured by the camera with the least
noise. A camera that this projector hardly lights is left out.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import BoolArray, FloatArray
from counterlight.raster import Shape, Shapes
from counterlight.response import Response
from counterlight.screen import parts_of
from counterlight.tools.acquisition.acquire import AGAIN, refuse_unusable, rises
from counterlight.tools.acquisition.camera_shift import refuse_moved
from counterlight.tools.acquisition.check import Check
from counterlight.tools.acquisition.few.fitting import Fit, fitted
from counterlight.tools.acquisition.few.held_out import RAMPS_ALONE, Held, bend_by, check_ramps, held_out
from counterlight.tools.acquisition.few.order import Order
from counterlight.tools.acquisition.few.places import located
from counterlight.tools.acquisition.few.response import Curves, curves_of
from counterlight.tools.acquisition.few.seen import SUMMED, Seen, noise_by_neighbours, reference
from counterlight.tools.acquisition.linearity import Bend
from counterlight.tools.acquisition.plan import Noise, Reference
from counterlight.tools.acquisition.ramps import CODES, ProjectorLight, crosstalk
from counterlight.tools.acquisition.wander import Wander, steadied_by_border
from counterlight.tools.joining.cameras import seen_below
from counterlight.tools.transport.transport import Transport


@dataclass(frozen=True)
class View:
    """The fit of one camera.

    name : prefix of messages; empty for the only camera.
    part : the camera's part of the raster.
    wander : gains of the camera's captures.
    bend : bend of the camera, 0 if linear; None without random pictures.
    """

    name: str
    part: tuple[slice, slice]
    seen: Seen
    fit: Fit
    held: Held | None
    bend: Bend | None
    wander: Wander

    @property
    def check(self) -> Check:
        return check_ramps(self.fit) if self.held is None else self.held.check

    def __str__(self) -> str:
        return f"{self.name}{RAMPS_ALONE if self.held is None else self.held}"


@dataclass(frozen=True)
class Views:
    """The fits of all cameras that the projector lights.

    black : (height, width, 3). Black of the raster.
    cameras : (height, width) of each; empty for one.
    curves : response of the projector.
    """

    views: tuple[View, ...]
    black: FloatArray
    saturated: BoolArray
    cameras: Shapes
    projector: Shape
    curves: Curves

    @property
    def check(self) -> Check:
        """The check of the worst camera; its `lights` are left out if there are several cameras."""
        worst = max((view.check for view in self.views), key=lambda check: check.error)
        return replace(worst, lights=None) if self.cameras else worst

    @property
    def wander(self) -> Wander:
        """The gains of the camera whose gains wander most."""
        return max((view.wander for view in self.views), key=lambda wander: float(wander.spread.max()))

    @property
    def transport(self) -> Transport:
        if not self.cameras:
            return self.views[0].fit.transport
        by_part = {_corner(view.part): view.fit.transport for view in self.views}
        found = [by_part.get(_corner(part)) for part in parts_of(self.cameras)]
        return seen_below(found, self.cameras, self.projector)

    @property
    def room(self) -> Reference:
        """The room of all cameras, with the noise of the noisiest camera."""
        noises = [view.seen.room.noise for view in self.views]
        noise = Noise(*(np.max([getattr(each, name) for each in noises], axis=0) for name in ("dark", "gain")))
        light = np.zeros(self.black.shape)
        for view in self.views:
            light[view.part] = view.seen.room.floodlight - view.seen.room.black
        return Reference(self.black, self.black + light, noise, self.saturated)

    @property
    def light(self) -> ProjectorLight:
        """The primaries, the response, and the difference between white and the sum of the primaries."""
        primaries = np.zeros((3, *self.black.shape), np.float32)
        for view in self.views:
            height, width = view.seen.camera
            primaries[:, *view.part] = view.fit.primaries.transpose(2, 0, 1).reshape(3, height, width, 3)
        curves, clarity = self.curves, sum(float(view.seen.clarity.sum()) for view in self.views)
        return ProjectorLight(
            response=curves.response,
            gammas=curves.gammas,
            primaries=primaries,
            fitted=curves.pooled,
            noise=curves.noise,
            unadded=self._unadded(),
            unadded_noise=4 / float(np.sqrt(max(clarity, 1.0))),
            segment=None,
            crosstalk=crosstalk(primaries.reshape(3, -1, 3).astype(np.float64), self.room),
        )

    def _unadded(self) -> FloatArray:
        unadded, off, light = np.zeros(len(CODES)), 0.0, 0.0
        for view in self.views:
            seen = view.seen
            weights = np.where(seen.clarity > 0, seen.light, 0)
            for white in seen.order.whites(seen.count)[:1]:
                off += float(np.vdot(weights, seen.above[white] - seen.primaries.sum(axis=2)))
                light += float(np.vdot(weights, seen.light))
        unadded[-1] = off / light if light else 0.0
        return unadded


def views_fitted(
    order: Order,
    captures: Sequence[NDArray[np.float32]],
    saturated: BoolArray,
    cameras: Shapes,
    given: Response | None,
    name: str = "",
) -> Views:
    """Fit a projector's captures.

    captures : radiance of the raster.
    cameras : (height, width) of each of several; empty for one.
    given : the projector's response, if it replaces the measured response.
    name : prefix of messages that names the projector.

    Raises InputError for captures that are saturated or black, and for a moved camera.
    """
    height, width = captures[0].shape[:2]
    parts = parts_of(cameras) if cameras else ((slice(0, height), slice(0, width)),)
    names = [f"camera {number}: " if cameras else "" for number in range(1, len(parts) + 1)]
    steadied = [_steadied(order, [capture[part] for capture in captures], saturated[part]) for part in parts]
    lit = [rises(_judged(each.room)) for each, _ in steadied]
    candidates = []
    for said, part, (each, wander), counts in zip(names, parts, steadied, lit, strict=True):
        if counts or not any(lit):
            refuse_unusable(_judged(each.room), f"{name}{said}")
            _refuse_moved(each)
            candidates.append((said, part, each, wander))
    curves = min((curves_of(each, given)[0] for _, _, each, _ in candidates), key=lambda each: each.noise)
    views = tuple(_view(*each, curves, order.random(len(captures))) for each in candidates)
    black = np.asarray(captures[0], np.float64).copy()
    for view in views:
        black[view.part] = view.seen.room.black
    return Views(views, black, saturated, cameras, order.projector, curves)


def _judged(room: Reference) -> Reference:
    """Returns the room with the noise of a summed floodlight, to decide whether it is lit."""
    noise = noise_by_neighbours(room)
    return replace(room, noise=replace(noise, dark=SUMMED * noise.dark))


def _refuse_moved(seen: Seen) -> None:
    """Raises InputError if anything moved between white pictures."""
    whites = seen.order.whites(seen.count)
    for later in whites[1:]:
        before, after = (seen.above[number].astype(np.float64) for number in (whites[0], later))
        refuse_moved(before, after, seen.room.noise, 2, AGAIN)


def _steadied(order: Order, captures: list[NDArray[np.float32]], saturated: BoolArray) -> tuple[Seen, Wander]:
    """Returns the equations of captures without wandering gains, and these gains."""
    seen = reference(order, captures, saturated)
    wander, steadied = steadied_by_border(seen.room, captures)
    return reference(order, steadied, saturated) if wander.is_active else seen, wander


def _view(name: str, part: tuple[slice, slice], seen: Seen, wander: Wander, curves: Curves, random: list[int]) -> View:
    spots = located(seen, curves.table)
    fit = fitted(seen, curves.table, spots, random)
    return View(name, part, seen, fit, held_out(seen, curves.table, spots, random), bend_by(fit, random), wander)


def _corner(part: tuple[slice, slice]) -> tuple[int, int]:
    return part[0].start, part[1].start

"""Several views of one room in one drive: what they must have in common, and where a prior may darken."""

from collections.abc import Sequence
from dataclasses import replace
from functools import reduce

import numpy as np

from counterlight.calibration import Calibration
from counterlight.errors import InputError
from counterlight.maps.room_maps import RefinementMaps, RoomMaps
from counterlight.viewpoints import JOIN

FAINTEST = 1e-5  # share of a step's curvature; a smaller value is float32 rounding


def check_views(views: Sequence[Calibration], where: str) -> None:
    """Raise InputError unless all views have the same projectors, cameras of one size, and one screen.

    where : prefix of the error message.
    """
    first = views[0]
    for number, view in enumerate(views[1:], 2):
        for what, mine, theirs in (
            ("projectors", _sizes(view), _sizes(first)),
            ("a camera", _size(view.camera.shape), _size(first.camera.shape)),
            ("a screen", _size(view.placed_on), _size(first.placed_on)),
        ):
            if mine != theirs:
                raise InputError(f"{where}: view {number} has {what} of {mine}, view 1 of {theirs}; {JOIN}")


def with_shared_darkness(maps: Sequence[RoomMaps]) -> list[RoomMaps]:
    """Return maps of views whose priors never darken a projector pixel that another view sees.

    A view's prior darkens pixels that its camera does not see (docs/mathematics.md 2). Between views, this would halve
    the light that another view needs. Each view therefore gets the smallest damping η of all views.
    """
    own = [each.refinement for each in maps if each.refinement is not None]
    least = reduce(np.minimum, (each.prior.damping for each in own))
    damped = [replace(each, prior=replace(each.prior, damping=least)) for each in own]
    return [
        replace(room, refinement=replace(new, step_size=_step_size(old, new)))
        for room, old, new in zip(maps, own, damped, strict=True)
    ]


def _step_size(old: RefinementMaps, new: RefinementMaps) -> np.ndarray:
    """Return 1 / (d + the new prior's bound); d is the old curvature minus the old bound."""
    curvature = np.divide(1, old.step_size, out=np.zeros_like(old.step_size), where=old.step_size > 0)
    lit = curvature - old.prior.bound
    total = np.where(lit > FAINTEST * curvature, lit, 0) + new.prior.bound
    kept = (old.step_size > 0) & (total > FAINTEST * curvature)
    return np.divide(1, total, out=np.zeros_like(total), where=kept).astype(np.float32)


def _sizes(view: Calibration) -> str:
    return " + ".join(_size(projector.shape) for projector in view.projectors)


def _size(shape: tuple[int, int]) -> str:
    return f"{shape[1]}x{shape[0]}"

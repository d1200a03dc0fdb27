"""Views of one room played together: what they must have in common, and whose darkness holds where."""

from collections.abc import Sequence
from dataclasses import replace
from functools import reduce

import numpy as np

from counterlight.calibration import Calibration
from counterlight.errors import InputError
from counterlight.maps.room_maps import RefinementMaps, RoomMaps
from counterlight.viewpoints import JOIN

FAINTEST = 1e-5  # of a step's curvature: less is float32's rounding of the rest


def check_views(views: Sequence[Calibration], where: str) -> None:
    """InputError unless views have the same projectors, cameras of one size, and one screen.

    where : said of them.
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
    """Maps of views, all with refinement's, none of which holds a projector pixel dark that another one sees.

    A view's prior draws to darkness what its camera does not see (docs/mathematics.md 2); between views that would
    halve what the other asks for. So each has the least of all views' dampings η.
    """
    own = [each.refinement for each in maps if each.refinement is not None]
    least = reduce(np.minimum, (each.prior.damping for each in own))
    damped = [replace(each, prior=replace(each.prior, damping=least)) for each in own]
    return [
        replace(room, refinement=replace(new, step_size=_step_size(old, new)))
        for room, old, new in zip(maps, own, damped, strict=True)
    ]


def _step_size(old: RefinementMaps, new: RefinementMaps) -> np.ndarray:
    """1 / (d + the new prior's bound), d being what the old steps had beside the old bound."""
    curvature = np.divide(1, old.step_size, out=np.zeros_like(old.step_size), where=old.step_size > 0)
    lit = curvature - old.prior.bound
    total = np.where(lit > FAINTEST * curvature, lit, 0) + new.prior.bound
    kept = (old.step_size > 0) & (total > FAINTEST * curvature)
    return np.divide(1, total, out=np.zeros_like(total), where=kept).astype(np.float32)


def _sizes(view: Calibration) -> str:
    return " + ".join(_size(projector.shape) for projector in view.projectors)


def _size(shape: tuple[int, int]) -> str:
    return f"{shape[1]}x{shape[0]}"

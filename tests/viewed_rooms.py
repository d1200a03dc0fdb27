"""A set of two views for tests: two small physical rooms, seen from 0 and from 1."""

from dataclasses import replace

import numpy as np

from counterlight.media.video import Frame
from counterlight.pipeline.room import Room
from counterlight.viewpoints import Places
from tests.refined_rooms import PhysicalRoom, physical_room
from tests.rooms import CAMERA, rgb_frame


def two_views(*, far: bool = False) -> list[PhysicalRoom]:
    """Return two rooms of equal size. Their T, ambient light and masks differ more than real views."""
    return [physical_room(np.random.default_rng(seed), far=far) for seed in (1, 2)]


def as_set(views: list[PhysicalRoom], start: str = "previous") -> Room:
    first, second = (replace(view.room, start=start) for view in views)
    return replace(first, others=(second,), places=Places(((0, 0), (1, 0))))


def letters(seed: int = 0) -> Frame:
    """Return black, grey and white pixels."""
    codes = np.random.default_rng(seed).choice([0, 90, 255], (*CAMERA, 3)).astype(np.uint8)
    return rgb_frame(codes)

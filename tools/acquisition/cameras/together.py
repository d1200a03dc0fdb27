"""Several cameras that photograph every pattern; a capture holds their pictures below each other."""

from collections.abc import Sequence

import numpy as np

from counterlight.errors import InputError
from counterlight.screen import parts_of, raster_of
from counterlight.tools.acquisition.cameras.camera import Camera, Shot
from counterlight.tools.acquisition.cameras.live import Eye, LiveCamera

Shape = tuple[int, int]


class TogetherEye:
    """Joins cameras: narrower pictures are padded with black, and all cameras share the exposures."""

    def __init__(self, eyes: Sequence[Eye]) -> None:
        self._eyes = tuple(eyes)
        self._shapes: tuple[Shape, ...] = ()

    @property
    def name(self) -> str:
        return " + ".join(eye.name for eye in self._eyes)

    @property
    def timed(self) -> bool:
        return any(eye.timed for eye in self._eyes)

    @property
    def views(self) -> tuple[Shape, ...]:
        """(height, width) of each camera's pictures."""
        if not self._shapes:
            self.frame()
        return self._shapes

    def begin(self, number: int) -> None:
        for eye in self._eyes:
            eye.begin(number)

    def expose(self, time: float) -> None:
        for eye in self._eyes:
            eye.expose(time)

    def skip(self) -> None:
        for eye in self._eyes:
            eye.skip()

    def frame(self) -> Shot:
        shots = [eye.frame() for eye in self._eyes]
        kinds = {(shot.dtype, shot.ndim) for shot in shots}
        if len(kinds) > 1:
            said = ", ".join(f"{shot.dtype} {'colour' if shot.ndim == 3 else 'grey'}" for shot in shots)
            raise InputError(
                f"cameras whose captures differ ({said}); set all to the same depth, all to colour or grey"
            )
        self._shapes = tuple((shot.shape[0], shot.shape[1]) for shot in shots)
        together = np.zeros((*raster_of(self._shapes), *shots[0].shape[2:]), shots[0].dtype)
        for part, shot in zip(parts_of(self._shapes), shots, strict=True):
            together[part] = shot
        return together


def together(eyes: Sequence[Eye]) -> Eye:
    """Joins several sources of frames; a single source is returned unchanged."""
    return eyes[0] if len(eyes) == 1 else TogetherEye(eyes)


def views_of(camera: Camera) -> tuple[Shape, ...]:
    """Returns the (height, width) of each of several cameras in one capture; empty for a single camera."""
    eye = _eyes_of(camera)
    return () if eye is None else eye.views


def _eyes_of(camera: Camera) -> TogetherEye | None:
    eye = camera.eye if isinstance(camera, LiveCamera) else None
    return eye if isinstance(eye, TogetherEye) else None

"""The player's renderer in Python, without a window (docs/api.md)."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from counterlight.arrays import FloatArray
from counterlight.errors import InputError
from counterlight.maps.room_maps import RoomMaps
from counterlight.pipeline.refinement import MOST_STEPS, Certificate
from counterlight.tools import arguments
from counterlight.tools.api import Room, check_maps
from counterlight.tools.arguments import in_python


class Renderer:
    """The player's renderer without a window, for pictures of the camera's size; a context manager.

    backend : "gl" (OpenGL through EGL), "cpu", or "auto" ("gl" if there is a GPU).
    white : radiance of a white picture; None takes the maps' white.
    """

    @in_python()
    def __init__(self, room: Room, maps: RoomMaps, *, backend: str = "gl", white: float | None = None) -> None:
        from counterlight.pipeline.device import BACKENDS
        from counterlight.pipeline.room import Room as Rendered
        from counterlight.pipeline.room import start_of
        from counterlight.show.headless import headless_renderer

        check_maps(room, maps)
        self._backend = arguments.choice(backend, "backend", BACKENDS)
        self._in_white = white is None
        self._white = arguments.white(white, maps.white)
        self._room = Rendered(room.calibration, maps, self._white, start=start_of(maps))
        self._stack = ExitStack()
        self._renderer = self._stack.enter_context(headless_renderer(backend, self._room))
        self._steps: int | None = None
        self._closed = False

    def __repr__(self) -> str:
        camera, projector = self._room.calibration.camera.shape, self._room.calibration.projector.shape
        return f"<Renderer {self._backend!r}: camera {camera}, projector {projector}, white {self._white:.4g}>"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @in_python()
    def render(self, picture: ArrayLike, *, refine: int | None = None) -> FloatArray:
        """Returns the projector picture for a camera picture, (projector height, projector width, 3), linear, 0 to 1.

        picture : (camera height, camera width, 3), as for `solve`.
        refine : steps, at most 256; None for the default number.
        """
        from counterlight.media.frames import radiance_frame

        self._check_open()
        steps = self._room.default_steps if refine is None else arguments.whole(refine, "refine", 0, MOST_STEPS)
        if steps and self._room.maps.refinement is None:
            raise InputError(
                f"refine={steps}: the maps were built without what steps need; build_maps(room, refine=True)"
            )
        shape = self._room.calibration.camera.shape
        desired = arguments.picture(picture, shape, "picture", of_white=self._in_white) * self._white
        frame = radiance_frame(np.asarray(self._room.maps.mixing.as_radiance(desired), np.float64))
        if self._steps is None:
            self._renderer.open(frame.format)
        self._steps = steps
        self._renderer.upload(frame)
        return self._view("projector")

    @in_python()
    def camera_view(self) -> FloatArray:
        """Returns the camera picture that the maps predict for the last rendered picture."""
        return self._view("camera")

    @in_python()
    def certificate(self) -> Certificate | None:
        """Returns a bound on the last picture's distance from the best; None without the maps of refinement."""
        self._check_rendered()
        return self._renderer.certificate()

    def close(self) -> None:
        """Release the renderer's resources; it cannot render afterwards."""
        self._closed = True
        self._stack.close()

    def _view(self, view: str) -> FloatArray:
        steps = self._check_rendered()
        self._renderer.render(view, compensate=True, steps=steps)
        return np.array(self._renderer.linear(), np.float64)

    def _check_rendered(self) -> int:
        """Returns the steps of the last rendered picture; InputError if there is none."""
        self._check_open()
        if self._steps is None:
            raise InputError("nothing has been rendered; call render first")
        return self._steps

    def _check_open(self) -> None:
        if self._closed:
            raise InputError("the renderer is closed; make another one")

"""Cost of a frame in the player: one picture as radiance, by the backend that users get on this machine."""

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import cache, cached_property

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.gl import context
from counterlight.gl.probe import probe_opengl
from counterlight.maps.mixing import Mixing
from counterlight.media.frames import radiance_frame
from counterlight.pipeline.operators import Compensation, compensation
from counterlight.pipeline.renderer import AnyRenderer
from counterlight.pipeline.room import Room
from counterlight.show.headless import headless_renderer

REPEATS, ENOUGH_S, MOST = 15, 0.1, 50


@cache
def graphics() -> str:
    """Returns the name of this machine's OpenGL renderer. Raises InputError with the fix if there is none."""
    return str(probe_opengl()["renderer"])


def in_software() -> bool:
    """Returns whether OpenGL runs on the processor. Frame times are then processor time."""
    return context.in_software(graphics())


@contextmanager
def player(backend: str, room: Room) -> Iterator["Player"]:
    """Open the player's renderer, "gl" or "cpu", without a window."""
    graphics()  # makes a separate context before the renderer makes one
    with headless_renderer(backend, room) as renderer:
        yield Player(renderer, room.maps.mixing)


class Player:
    """Renders pictures of one size as the player would.

    mixing : mixing of the room's primaries.
    """

    def __init__(self, renderer: AnyRenderer, mixing: Mixing) -> None:
        self._renderer, self._mixing = renderer, mixing
        self._open = False
        self._render: Callable[[], None] = lambda: None

    def show(self, desired: FloatArray, *, compensate: bool, steps: int) -> FloatArray:
        """Returns the drive for a desired picture, (projector pixels, 3), before encoding.

        desired : (camera height, camera width, 3), in screen primaries.
        """
        frame = radiance_frame(np.asarray(self._mixing.as_radiance(desired), np.float64))
        if not self._open:
            self._renderer.open(frame.format)
            self._open = True
        self._renderer.upload(frame)
        self._render = lambda: self._renderer.render("projector", compensate=compensate, steps=steps)
        self._render()
        return np.asarray(self._renderer.linear(), np.float64).reshape(-1, 3)

    def frame_s(self) -> float:
        """Returns the seconds to render the last picture once more, up to the encoded drive.

        A GPU gives the median of several wall-clock times. Software rendering gives the mean processor time over all
        cores.
        """
        self._frame()
        if in_software():
            return repeated_s(self._frame)
        times = []
        for _ in range(REPEATS):
            start = time.perf_counter()
            self._frame()
            times.append(time.perf_counter() - start)
        return float(np.median(times))

    def _frame(self) -> None:
        self._render()
        self._renderer.finish()


class Bench:
    """A room's maps in the player, kept while methods share them. Call close() at the end.

    room : maps, and the start of refinement.
    """

    def __init__(self, room: Room) -> None:
        self._room, self._stack = room, ExitStack()
        self.player = self._stack.enter_context(player("cpu" if in_software() else "gl", room))

    @cached_property
    def T_pinv(self) -> Compensation:  # noqa: N802 - as the thesis calls it
        """The drive that the player computes before the clamp."""
        return compensation(self._room.maps)

    def close(self) -> None:
        self._stack.close()


def repeated_s(work: Callable[[], object]) -> float:
    """Returns the mean processor seconds of as many runs as fill 0.1 s, at most 50.

    On a busy machine, means of 50 runs of 0.07 to 0.4 ms scatter by 2 to 7 %, means of 0.1 s by no less.
    """
    start, count, passed = time.process_time(), 0, 0.0
    while passed < ENOUGH_S and count < MOST:
        work()
        count, passed = count + 1, time.process_time() - start
    return passed / count

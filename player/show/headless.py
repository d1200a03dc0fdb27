"""Renders without a window: creates a renderer and passes every frame of a medium through it into a file."""

import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from counterlight.command import tell, track
from counterlight.errors import InputError
from counterlight.media.video import MediaReader
from counterlight.pipeline.content import camera_psnr
from counterlight.pipeline.device import BACKENDS, EVERYWHERE, GpuPath
from counterlight.pipeline.renderer import AnyRenderer
from counterlight.pipeline.room import Room
from counterlight.pipeline.shortfall import Shortfall
from counterlight.show.compiling import compile_passes
from counterlight.show.governor import Governor, draw
from counterlight.show.output import USUAL, Coding, open_output, write_picture
from counterlight.show.rendering import WHOLE, Stretch
from counterlight.show.stats import Stats

if TYPE_CHECKING:
    from counterlight.pipeline.survey import Survey

FRAME_TIMEOUT_S = 120.0
MOST_REDRAWS = 12  # redraws of a frame until its steps suffice.
ENDLESS = 1 << 62  # stands for an unknown number of frames


@contextmanager
def headless_renderer(backend: str, room: Room, path: GpuPath = EVERYWHERE) -> Iterator[AnyRenderer]:
    """Yield a renderer without a window, and release it at the end.

    "auto" chooses OpenGL if a GPU runs it, otherwise the CPU, because software OpenGL is slower (docs/gpu.md). The
    choice is printed. It follows a rule and not a measurement, so that results repeat.

    backend : "gl", OpenGL through EGL; "cpu", compiled for the processor; or "auto".
    path : choice of OpenGL's path.
    """
    if backend not in BACKENDS:
        raise InputError(f"backend {backend!r}: expected one of {', '.join(BACKENDS)}")
    with ExitStack() as stack:
        context = None if backend == "cpu" else _opengl(stack, chosen=backend == "gl")
        if context is None:
            yield _on_the_processor(room)
            return
        from counterlight.gl.renderer import GlRenderer

        renderer = GlRenderer(context, room, path)
        stack.callback(renderer.release)
        yield renderer


def chosen_backend(backend: str) -> str:
    """Return "gl" or "cpu", the same choice in every process."""
    if backend != "auto":
        return backend
    with ExitStack() as stack:
        return "cpu" if _opengl(stack, chosen=False) is None else "gl"


def _opengl(stack: ExitStack, *, chosen: bool) -> Any:
    """Return an OpenGL context on the stack. If no GPU runs OpenGL, return None unless OpenGL was `chosen`."""
    from counterlight.gl.context import headless_context, in_software

    try:
        context = stack.enter_context(headless_context("use --backend cpu"))
    except InputError:
        if chosen:
            raise
        tell("backend: cpu, there is no OpenGL through EGL here", sys.stdout)
        return None
    name = context.info["GL_RENDERER"]
    if chosen:
        return context
    if not in_software(name):
        tell(f"backend: gl, {name}", sys.stdout)
        return context
    stack.close()
    tell(f"backend: cpu, no GPU runs OpenGL here ({name})", sys.stdout)
    return None


def _on_the_processor(room: Room) -> AnyRenderer:
    compile_passes()
    from counterlight.pipeline.cpu_renderer import CpuRenderer

    return CpuRenderer(room)


def render_to_file(
    reader: MediaReader,
    renderer: AnyRenderer,
    room: Room,
    output: Path,
    view: str,
    *,
    compensate: bool,
    governor: Governor,
    stretch: Stretch = WHOLE,
    before: Path | None = None,
    quiet: bool = False,
    appraised: bool = False,
    sound: Path | None = None,
    coding: Coding = USUAL,
) -> Stats:
    """Render a stretch of an open medium into `output`, and return counts and times.

    before : receives the picture of the frame before the stretch, if that frame was drawn.
    appraised : whether to estimate how far the last frame is from the optimum.
    sound : see open_output.
    coding : see open_output.

    For the camera's view, the stats hold the mean PSNR against the target over the lit pixels. If the room has the
    maps of refinement, they hold the steps and the bound on the last frame's distance from the optimum. With a promise
    or `appraised`, they also hold the estimated distances of the last and of the worst frame.
    Raises InputError if the medium breaks off; the output is then removed.
    """
    stats, quality = Stats(), list[float]()
    _pass_over(reader, stretch.lead)
    drawing = _Drawing(renderer, room, governor, {"view": view, "compensate": compensate}, still=reader.info.still)
    with open_output(output, reader.info.frames_per_second, sound, coding) as sink:
        wanted = 1 if sink.single else stretch.end
        numbers = range(stretch.lead, ENDLESS if wanted is None else wanted)
        left = reader.info.frames and max(reader.info.frames - reader.index, 0)
        total = left if wanted is None else min(len(numbers), left or len(numbers))
        for index in numbers if quiet else track(numbers, "rendering", total or None):
            start = time.perf_counter()
            frame = reader.next_frame(FRAME_TIMEOUT_S)
            if frame is None:
                break
            decoded = time.perf_counter()
            renderer.upload(frame)
            reader.release(frame)
            uploaded = time.perf_counter()
            drawing.draw(index, stats)
            drawn = time.perf_counter()
            if index < stretch.begin:
                if index == stretch.begin - 1 and before is not None:
                    write_picture(before, renderer)
                continue
            sink.write(renderer, frame.time_s)
            stats.frames += 1
            for stage, seconds in (
                ("wait", decoded - start),
                ("decode", frame.decode_s),
                ("upload", uploaded - decoded),
                ("write", time.perf_counter() - drawn),
            ):
                stats.add(stage, seconds)
            if view == "camera":
                desired, seen = renderer.desired(), renderer.linear()
                quality.append(camera_psnr(desired, seen, room.lit, room.white))
        if stats.frames == 0:
            raise InputError(f"{reader.info.path}: no frame to render; check --start and --frames")
    stats.facts["gpu_path"] = renderer.path.to_dict()
    certificate = renderer.certificate()
    if certificate is not None:
        stats.facts["refinement"] = {**certificate.to_dict(), **drawing.outcome(appraised=appraised)}
    if quality:
        stats.facts["camera_psnr_db"] = float(np.mean(quality))
    return stats


class _Drawing:
    """Draws frames with the governor's steps. Redraws a picture that misses the promise, and a still with a budget.

    shown : the view, and whether it is compensated.
    """

    def __init__(
        self, renderer: AnyRenderer, room: Room, governor: Governor, shown: Mapping[str, Any], *, still: bool
    ) -> None:
        self._renderer, self._room, self._governor, self._shown, self._still = renderer, room, governor, shown, still
        self._steps = 0
        self._found: Shortfall | None = None
        self._worst_db = float("-inf")
        governor.looks = 1

    def draw(self, index: int, stats: Stats) -> None:
        governor = self._governor
        for _ in range(MOST_REDRAWS):
            self._steps = draw(self._renderer, governor, stats, **self._shown, frame=index)
            if governor.within != "no":
                self._appraise()
            missed = governor.within != "no" and self._found is not None and self._found.decibels > governor.within
            if governor.steps <= self._steps or not (missed or (self._still and governor.governs)):
                break
        if self._found is not None:
            self._worst_db = max(self._worst_db, self._found.decibels)

    def outcome(self, *, appraised: bool) -> dict[str, Any]:
        """Return the result for JSON.

        appraised : estimate the last frame's distance from the optimum if it is unknown.
        """
        if appraised and self._found is None:
            self._appraise()
        if self._found is None:
            return {"steps": self._steps}
        worst_db = max(self._worst_db, self._found.decibels)
        return {"steps": self._steps, **self._found.to_dict(), "worst_below_optimum_db": round(worst_db, 5)}

    def _appraise(self) -> None:
        snapshot = self._renderer.snapshot()
        if snapshot is not None and self._survey is not None:
            self._found = self._survey.of(snapshot)
            self._governor.judged(self._found)

    @cached_property
    def _survey(self) -> "Survey | None":
        from counterlight.pipeline.survey import Survey  # imported late, because Numba takes half a second

        return None if self._room.maps.refinement is None else Survey(self._room)


def _pass_over(reader: MediaReader, count: int) -> None:
    """Skip the first frames by decoding them, because a decoder may give other pictures just after a seek."""
    for _ in range(count):
        frame = reader.next_frame(FRAME_TIMEOUT_S)
        if frame is None:
            raise InputError(f"{reader.info.path}: ends earlier than it did; leave it as it is while it is rendered")
        reader.release(frame)

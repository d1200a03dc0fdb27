"""Rendering without a window: a renderer, and every frame of a medium through it into a file."""

import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from counterlight.calibration import Calibration
from counterlight.command import tell, track
from counterlight.errors import InputError
from counterlight.media.video import MediaReader
from counterlight.pipeline.content import camera_psnr
from counterlight.pipeline.renderer import Renderer
from counterlight.pipeline.room import Room
from counterlight.show.output import open_output
from counterlight.show.stats import Stats

FRAME_TIMEOUT_S = 120.0
BACKENDS = ("auto", "gl", "cpu")
PATIENCE_S = 1.0  # before compiling is worth a word


@contextmanager
def headless_renderer(backend: str, room: Room, path: str = "fragment") -> Iterator[Renderer]:
    """A renderer without a window, released at the end.

    backend : "gl", OpenGL through EGL, on one of PATHS; "cpu", compiled for the processor; or "auto", which says what
    it chose: OpenGL where a GPU runs it, else the processor, on which OpenGL is slower (docs/gpu.md). A rule and no
    measurement, so that a result repeats.
    """
    with ExitStack() as stack:
        context = None if backend == "cpu" else _opengl(stack, chosen=backend == "gl")
        if context is None:
            yield _on_the_processor(room)
            return
        from counterlight.gl.renderer import GlRenderer

        renderer = GlRenderer(context, room, path)
        stack.callback(renderer.release)
        yield renderer


def _opengl(stack: ExitStack, *, chosen: bool) -> Any:
    """A context of OpenGL on the stack; None where nobody has chosen OpenGL and no GPU runs it."""
    from counterlight.gl.context import headless_context, in_software

    try:
        context = stack.enter_context(headless_context())
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


def _on_the_processor(room: Room) -> Renderer:
    from counterlight.pipeline import compiled  # Numba takes half a second: not before it is used
    from counterlight.pipeline.cpu_renderer import CpuRenderer

    told = time.monotonic()
    for left in compiled.prepare():
        if time.monotonic() - told > PATIENCE_S:
            tell(f"compiling for this processor, once: {left} passes left", sys.stdout)
            told = time.monotonic()
    return CpuRenderer(room)


def render_to_file(
    reader: MediaReader,
    renderer: Renderer,
    calibration: Calibration,
    output: Path,
    view: str,
    *,
    compensate: bool,
    frames: int | None,
    white: float,
    steps: int = 0,
) -> Stats:
    """Render up to `frames` frames of an open medium into `output`; returns what was counted and timed.

    For the camera's view the stats hold the mean PSNR against the desired picture inside the mask; where the room has
    the maps for it, the steps of refinement and how far the last frame can be from the optimum.
    Raises InputError if the medium breaks off; the output is then removed.
    """
    stats, quality = Stats(), []
    with open_output(output, reader.info.frames_per_second) as sink:
        wanted = 1 if sink.single else frames
        for index in track(_count(wanted), "rendering", wanted):
            start = time.perf_counter()
            frame = reader.next_frame(FRAME_TIMEOUT_S)
            if frame is None:
                break
            decoded = time.perf_counter()
            renderer.upload(frame)
            reader.release(frame)
            uploaded = time.perf_counter()
            renderer.render(view, compensate=compensate, frame=index, steps=steps)
            renderer.finish()
            rendered = time.perf_counter()
            sink.write(renderer, frame.time_s)
            stats.frames += 1
            for stage, seconds in (
                ("wait", decoded - start),
                ("decode", frame.decode_s),
                ("upload", uploaded - decoded),
                ("gpu", rendered - uploaded),
                ("write", time.perf_counter() - rendered),
            ):
                stats.add(stage, seconds)
            if view == "camera":
                quality.append(camera_psnr(renderer.desired(), renderer.linear(), calibration.mask, white))
        if stats.frames == 0:
            raise InputError(f"{reader.info.path}: no frame to render; check --start and --frames")
    stats.facts["gpu_path"] = renderer.path.to_dict()
    certificate = renderer.certificate()
    if certificate is not None:
        stats.facts["refinement"] = {"steps": steps, **certificate.to_dict()}
    if quality:
        stats.facts["camera_psnr_db"] = float(np.mean(quality))
    return stats


def _count(limit: int | None) -> range:
    return range(limit if limit is not None else 1 << 62)

"""Measure how many frames per second this machine draws in a room, as `counterlight play` draws them."""

import time
from collections.abc import Sequence
from statistics import median

import numpy as np

from counterlight.media.frames import Frame, radiance_frame
from counterlight.memory import available_bytes
from counterlight.pipeline.renderer import AnyRenderer
from counterlight.pipeline.room import Room
from counterlight.show.headless import headless_renderer

TIMED_FRAMES = 5
COPIES = 3  # assumed number of copies of the maps in memory while frames are drawn


def frames_per_second(room: Room, steps: Sequence[int]) -> list[float]:
    """Returns the rate of drawing a grey picture for each number of steps; empty if memory is short."""
    if COPIES * sum(each.nbytes for each in room.maps.named().values()) > available_bytes():
        return []
    grey = np.full((*room.calibration.camera.shape, 3), 0.5 * room.white)
    frame = radiance_frame(grey)
    with headless_renderer("auto", room) as renderer:
        renderer.open(frame.format)
        for count in steps:  # the first frame loads and compiles what later frames reuse
            draw_seconds(renderer, frame, count)
        return [1 / median(draw_seconds(renderer, frame, count) for _ in range(TIMED_FRAMES)) for count in steps]


def draw_seconds(renderer: AnyRenderer, frame: Frame, steps: int) -> float:
    """Returns the seconds from a decoded frame to the projector picture."""
    start = time.perf_counter()
    renderer.upload(frame)
    renderer.render("projector", compensate=True, steps=steps)
    renderer.finish()
    return time.perf_counter() - start

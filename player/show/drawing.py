"""Draws one frame with the governor's steps, for windows and files alike."""

import time

from counterlight.pipeline.renderer import AnyRenderer
from counterlight.show.governor import Governor
from counterlight.show.stats import Stats


def draw(
    renderer: AnyRenderer,
    governor: Governor,
    stats: Stats,
    view: str,
    *,
    compensate: bool,
    frame: int,
    timed: bool = True,
) -> int:
    """Render the uploaded frame, report its times to the governor and the statistics, and return its steps.

    timed : also measure each stage, for which the renderer waits after each stage.
    """
    start, steps = time.perf_counter(), governor.steps
    renderer.start_from(governor.start, governor.bare)
    renderer.render(view, compensate=compensate, frame=frame, steps=steps, timed=timed)
    renderer.finish()
    seconds, stage_s = time.perf_counter() - start, renderer.stage_s if timed else {}
    stats.add("gpu", seconds)
    stats.add_stages(stage_s, steps)
    governor.took(seconds, steps, stage_s)
    return steps

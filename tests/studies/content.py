"""Effects of adaptation and damping: python -m tests.studies.content [FOLDER].

Prints the tables of docs/content.md and writes FOLDER/content.png. The room is calib_data/scenes/corner.toml, simulated
and built into FOLDER once, or into a temporary folder. The frames are a piece of the shipped clip with a cut between
two passages, and one frame with new noise in every repetition. The GPU player makes the drives and predicts the
camera's view.
"""

import os
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

import cv2
import moderngl
import numpy as np
from numpy.typing import NDArray

from counterlight.gl.context import headless_context
from counterlight.gl.renderer import GlRenderer
from counterlight.media.video import Frame, MediaReader
from counterlight.pipeline.adjustments import Adjustments
from counterlight.pipeline.content import camera_psnr
from counterlight.pipeline.cpu_renderer import CpuRenderer
from counterlight.pipeline.room import Room, read_room
from counterlight.tools.shipped import CLIP, shipped_scenes
from counterlight.tools.show_example import prepare
from tests.bench.frames import clock_of

PASSAGES_S, FRAMES = (2.0, 0.5), 12  # start of each passage, and frames per passage
NOISY, NOISE = 12, 2.0  # repetitions of a frame, standard deviation in code values
STEPS, REPEATS = 4, 7
ADAPT, FLICKER = (0, 1, 3, 10), (0, 0.3, 0.6, 0.9)
CORNERS = ((0.15, 0.1), (0.8, 0.2), (0.9, 0.85), (0.1, 0.7))
ADAPTED = (
    "white",
    "adapt",
    "clipped light, % (worst frame)",
    "PSNR to what was asked, dB (worst)",
    "PSNR to the picture before adaptation, dB",
    "mean radiance asked for, % of the picture's",
    "the camera's view changes from frame to frame by, % of white",
)
DAMPED = (
    "flicker",
    "noise: the camera's view changes by, % of white",
    "film: likewise",
    "noise: PSNR to what was asked, dB",
    "film: likewise (worst)",
)
FloatArray = NDArray[np.float64]


@dataclass
class Shown:
    """Radiance of each frame: the target, and what the camera sees."""

    asked: list[FloatArray] = field(default_factory=list)
    seen: list[FloatArray] = field(default_factory=list)


def clip_frames() -> Iterator[Frame]:
    with MediaReader.open(CLIP) as reader:
        for start in PASSAGES_S:
            reader.seek(start)
            for _ in range(FRAMES):
                frame = reader.next_frame(60.0)
                assert frame is not None
                yield frame
                reader.release(frame)


def noisy_frames() -> Iterator[Frame]:
    rng = np.random.default_rng(8)
    with MediaReader.open(CLIP) as reader:
        reader.seek(PASSAGES_S[0])
        frame = reader.next_frame(60.0)
        assert frame is not None
        for _ in range(NOISY):
            luma = frame.planes[0] + np.round(rng.normal(0, NOISE, frame.planes[0].shape))
            yield replace(frame, planes=(np.clip(luma, 16, 235).astype(np.uint8), *frame.planes[1:]))


def show(renderer: GlRenderer, frames: Iterator[Frame], adjustments: Adjustments) -> Shown:
    shown = Shown()
    for index, frame in enumerate(frames):
        if index == 0:
            renderer.open(frame.format)
            renderer.adjust(adjustments)
        renderer.upload(frame)
        renderer.render("camera", compensate=True, steps=STEPS)
        shown.seen.append(renderer.linear().astype(np.float64))
        shown.asked.append(renderer.desired().astype(np.float64))
    return shown


class Limits:
    """The clipped light, defined as in pipeline/content.py, over all pixels and by other code than the player's."""

    def __init__(self, room: Room) -> None:
        self._cpu = CpuRenderer(room)
        self._most, self._ambient = self._cpu._main_view.views.most, room.calibration.ambient.astype(np.float64)

    def clipped(self, asked: FloatArray, first_asked: FloatArray) -> float:
        """Returns the clipped light as a share of the target before adaptation."""
        near = self._cpu._main_view.near_light(asked - self._ambient)
        missed = np.abs(near - np.clip(near, 0, self._most[..., :3]))
        counts = self._most[..., 3] > 0
        return float(missed[counts].sum() / np.maximum(first_asked, self._ambient)[counts].sum())


def adaptation(room: Room, limits: Limits, renderer: GlRenderer) -> None:
    mask, white = room.calibration.mask, room.white
    plain = show(renderer, clip_frames(), Adjustments())
    for percent in ADAPT:
        shown = show(renderer, clip_frames(), Adjustments(adapt=percent)) if percent else plain
        clipped = [100 * limits.clipped(c, first) for c, first in zip(shown.asked, plain.asked, strict=True)]
        found = [camera_psnr(c, seen, mask, white) for c, seen in zip(shown.asked, shown.seen, strict=True)]
        first = [camera_psnr(c, seen, mask, white) for c, seen in zip(plain.asked, shown.seen, strict=True)]
        light = [c[mask].mean() / first[mask].mean() for c, first in zip(shown.asked, plain.asked, strict=True)]
        row(
            f"{white:.3g}",
            f"{percent} %" if percent else "off",
            f"{np.mean(clipped):.1f} ({max(clipped):.1f})",
            f"{np.mean(found):.1f} ({min(found):.1f})",
            f"{np.mean(first):.1f}",
            f"{100 * np.mean(light):.0f}",
            f"{np.mean(changes(shown.seen, mask, white)):.2f}",
        )


def damping(room: Room, renderer: GlRenderer) -> None:
    mask, white = room.calibration.mask, room.white
    print()
    header(*DAMPED)
    for weight in FLICKER:
        noisy, film = (show(renderer, frames(), Adjustments(flicker=weight)) for frames in (noisy_frames, clip_frames))
        quality = [
            [camera_psnr(c, seen, mask, white) for c, seen in zip(shown.asked, shown.seen, strict=True)]
            for shown in (noisy, film)
        ]
        row(
            f"{weight:g}" if weight else "off",
            *(f"{np.mean(changes(shown.seen, mask, white)):.2f}" for shown in (noisy, film)),
            f"{np.mean(quality[0]):.1f}",
            f"{np.mean(quality[1]):.1f} ({min(quality[1]):.1f})",
        )


def changes(pictures: list[FloatArray], mask: NDArray[np.bool_], white: float) -> list[float]:
    """Returns the mean absolute changes from frame to frame, in percent of white, without the cut."""
    pairs = [(a, b) for i, (a, b) in enumerate(pairwise(pictures), 1) if i % FRAMES]
    return [100 * float(np.abs(b - a)[mask].mean()) / white for a, b in pairs]


def costs(renderer: GlRenderer) -> None:
    """Print milliseconds per frame, the fastest of REPEATS in turns: processor time where OpenGL is llvmpipe."""
    clock = clock_of(moderngl.get_context())
    processor = "processor " if clock is time.process_time else ""
    settings = {
        "neutral": Adjustments(),
        "controls and black level": Adjustments(10, 10, 10, 10, 0.05),
        "adapt": Adjustments(adapt=3),
        "flicker": Adjustments(flicker=0.5),
        "corners": Adjustments(corners=CORNERS),
        "clipping map": Adjustments(clipping=True),
    }
    fastest = dict.fromkeys(settings, np.inf)
    for _ in range(REPEATS):
        for name, picture in settings.items():
            renderer.adjust(picture)
            begin = clock()
            renderer.render("projector", compensate=True, steps=STEPS)
            renderer.finish()
            fastest[name] = min(fastest[name], 1000 * (clock() - begin))
    print()
    header("a frame in the projector's view", f"{processor}ms, fastest of {REPEATS} in turns")
    for name, milliseconds in fastest.items():
        row(name, f"{milliseconds:.0f}")


def draw_views(renderer: GlRenderer, path: Path) -> None:
    """Write the camera's view, its error, the clipping and the impossible map; below them the same with adaptation."""
    frame = next(clip_frames())
    renderer.open(frame.format)
    renderer.upload(frame)
    rows = []
    for adapt in (0, 3):
        views = []
        for view, clipping in (("camera", False), ("error", False), ("camera", True), ("impossible", False)):
            renderer.adjust(Adjustments(adapt=adapt, clipping=clipping))
            renderer.render(view, compensate=True, steps=STEPS)
            views.append(renderer.encoded()[..., ::-1])
        rows.append(np.hstack(views))
    cv2.imwrite(str(path), cv2.resize(np.vstack(rows), None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))


def header(*cells: str) -> None:
    row(*cells)
    print("|---" * len(cells) + "|")


def row(*cells: str) -> None:
    print(f"| {' | '.join(cells)} |", flush=True)


def run(context: moderngl.Context, folder: Path) -> None:
    print(f"{os.cpu_count()} cores, {context.info['GL_RENDERER']}")
    prepare(shipped_scenes()["corner"], folder / "corner")
    room = read_room(folder / "corner", None)
    print()
    header(*ADAPTED)
    for brighter in (1.0, 1.5):
        asked = replace(room, white=brighter * room.white)
        with ExitStack() as made:
            adaptation(asked, Limits(asked), renderer_of(context, asked, made))
    with ExitStack() as made:
        renderer = renderer_of(context, room, made)
        damping(room, renderer)
        costs(renderer)
        draw_views(renderer, folder / "content.png")


def renderer_of(context: moderngl.Context, room: Room, made: ExitStack) -> GlRenderer:
    """Returns a renderer that is released with `made`."""
    renderer = GlRenderer(context, room)
    made.callback(renderer.release)
    return renderer


def main() -> None:
    with headless_context() as context:
        if len(sys.argv) > 1:
            run(context, Path(sys.argv[1]))
        else:
            with tempfile.TemporaryDirectory() as folder:
                run(context, Path(folder))


if __name__ == "__main__":
    main()

"""Everything that a process needs to render a file, or a part of a file."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from counterlight.media.medium import Medium
from counterlight.media.video import MediaReader
from counterlight.pipeline.adjustments import Adjustments
from counterlight.pipeline.device import GpuPath
from counterlight.pipeline.room import Room, read_room


@dataclass(frozen=True)
class Stretch:
    """Frames `begin` to `end` − 1 of a film, counted from 0 where rendering starts.

    lead : first frame that is drawn; it is drawn like a frame after a cut. Frames before `begin` are drawn but not
        written.
    begin : first frame that is written.
    end : None for the end of the film.
    """

    lead: int = 0
    begin: int = 0
    end: int | None = None


WHOLE = Stretch()


@dataclass(frozen=True)
class Rendering:
    """The input and the options of a rendering.

    white : camera radiance of a white picture.
    steps : steps of refinement per frame.
    start : start of refinement.
    start_s : time in the medium where rendering begins.
    frames : most frames; None for all.
    backend : "gl" or "cpu".
    path : choice of OpenGL's path.
    """

    calibration: Path
    white: float
    dither: str
    steps: int
    start: str
    medium: Medium
    loop: bool
    frames_per_second: float | None
    start_s: float
    frames: int | None
    backend: str
    path: GpuPath
    view: str
    compensate: bool
    adjustments: Adjustments

    def room(self) -> Room:
        start, refinement = self.start if self.steps else None, self.steps > 0
        words = self.path.entries != "16"
        return read_room(self.calibration, self.white, self.dither, start, refinement=refinement, words=words)

    @contextmanager
    def opened(self) -> Iterator[MediaReader]:
        """Yield the medium, at its first frame."""
        with MediaReader.open(self.medium, loop=self.loop, frames_per_second=self.frames_per_second) as reader:
            if self.start_s:
                reader.seek(self.start_s)
            yield reader

    @property
    def carries(self) -> bool:
        """Whether a frame depends on the frame before, unless a cut separates them."""
        adjustments = self.adjustments
        refined = self.compensate and self.steps > 0 and self.start.startswith("previous")
        return bool(refined or adjustments.adapt or adjustments.flicker)

"""What a file is rendered from and how: all that a process needs to know which renders it, or a part of it."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from counterlight.media.medium import Medium
from counterlight.media.video import MediaReader
from counterlight.pipeline.adjustments import Adjustments
from counterlight.pipeline.room import Room, read_room


@dataclass(frozen=True)
class Stretch:
    """Frames `begin` to `end` − 1 of a film, counted from 0 where rendering starts.

    lead : from there on frames are drawn, the first as after a cut; none before `begin` is written.  end : None for the
    film's.
    """

    lead: int = 0
    begin: int = 0
    end: int | None = None


WHOLE = Stretch()


@dataclass(frozen=True)
class Rendering:
    """white : camera radiance of a white picture.  steps : of refinement, every frame; start : where they begin.

    start_s : of the medium, where rendering begins.  frames : at most; None for all.
    backend : "gl" or "cpu".  path : one of counterlight.pipeline.device.PATHS.
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
    path: str
    view: str
    compensate: bool
    adjustments: Adjustments

    def room(self) -> Room:
        start, words = self.start if self.steps else None, "words" in self.path
        return read_room(self.calibration, self.white, self.dither, self.steps, start, words=words)

    @contextmanager
    def opened(self) -> Iterator[MediaReader]:
        """The medium, at its first frame."""
        with MediaReader.open(self.medium, loop=self.loop, frames_per_second=self.frames_per_second) as reader:
            if self.start_s:
                reader.seek(self.start_s)
            yield reader

    @property
    def carries(self) -> bool:
        """Whether a frame goes on from the one before, unless it begins anew at a cut."""
        adjustments = self.adjustments
        refined = self.compensate and self.steps > 0 and self.start.startswith("previous")
        return bool(refined or adjustments.adapt or adjustments.flicker)

"""Fades over time: how much of the light is shown, and the weight of a medium that fades out."""

from collections.abc import Callable

from counterlight.pipeline.renderer import AnyRenderer
from counterlight.show.playback import Playback

FADE_WAIT_S = 1 / 60  # time between two pictures of a fade while no frame is due


class Fade:
    """Share of the light that is shown: 0 (black) at first, then moving at a constant rate to the requested level.

    seconds : time from black to full light; 0 switches at once.
    """

    def __init__(self, seconds: float, clock: Callable[[], float]) -> None:
        self.seconds, self._clock = seconds, clock
        self.level = 0.0
        self._at_s: float | None = None

    def towards(self, level: float) -> float:
        """Move towards `level` and return the share at this time."""
        now_s = self._clock()
        spent_s, self._at_s = 0.0 if self._at_s is None else now_s - self._at_s, now_s
        step = spent_s / self.seconds if self.seconds else 1.0
        self.level += min(max(level - self.level, -step), step)
        return self.level


class Leaving:
    """A medium that keeps playing while the next medium fades in over `seconds`."""

    def __init__(self, playback: Playback, seconds: float, clock: Callable[[], float]) -> None:
        self.playback, self._seconds, self._clock, self._began_s = playback, seconds, clock, clock()

    @property
    def weight(self) -> float:
        """Share of the leaving medium in the picture, falling from 1 to 0."""
        return max(1.0 - (self._clock() - self._began_s) / self._seconds, 0.0)

    def upload_into(self, renderer: AnyRenderer) -> bool:
        """Pass the frame that is due to a renderer, and return whether a frame was due."""
        frame = self.playback.due()
        if frame is None:
            return False
        renderer.upload_before(frame)
        self.playback.reader.release(frame)
        return True

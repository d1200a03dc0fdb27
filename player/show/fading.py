"""Fades on a clock: how much of the light is shown, and how much is left of the medium that fades out."""

from collections.abc import Callable

from counterlight.show.playback import Playback

FADE_WAIT_S = 1 / 60  # between the pictures of a fade, where no frame is due


class Fade:
    """Share of the light: 0, black, at first, and on its way to 0 or 1 as long as `towards` asks for another.

    seconds : from black to full light; 0 for at once.
    """

    def __init__(self, seconds: float, clock: Callable[[], float]) -> None:
        self.seconds, self._clock = seconds, clock
        self.level = 0.0
        self._at_s: float | None = None

    def towards(self, level: float) -> float:
        """The share now."""
        now_s = self._clock()
        spent_s, self._at_s = 0.0 if self._at_s is None else now_s - self._at_s, now_s
        step = spent_s / self.seconds if self.seconds else 1.0
        self.level += min(max(level - self.level, -step), step)
        return self.level


class Leaving:
    """A medium that plays on while another fades in over `seconds`."""

    def __init__(self, playback: Playback, seconds: float, clock: Callable[[], float]) -> None:
        self.playback, self._seconds, self._clock, self._began_s = playback, seconds, clock, clock()

    @property
    def weight(self) -> float:
        """Share of its picture, from 1 to 0."""
        return max(1.0 - (self._clock() - self._began_s) / self._seconds, 0.0)

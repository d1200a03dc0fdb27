"""What every source of decoded pictures offers: laps, and pictures with their time.

A lap is one pass from a given time to the end. Sources run inside the decoder process only.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

from counterlight.media.decoding.pixels import Samples
from counterlight.media.frames import MediaInfo

TIME_SLACK_S = 1e-6  # far below one frame, far above the rounding of a float64 time


class FormatChangedError(Exception):
    """A live source sends pictures of another size or kind than before: whoever shows them has to open it again."""


@dataclass(frozen=True)
class Decoded:
    """One picture of a medium: seconds since the first one, and its samples (valid until the next is asked for).

    corrupt : FFmpeg has patched it up; a source that yields it leaves it out.
    """

    time_s: float
    duration_s: float
    samples: Samples
    corrupt: bool = False


class Source(Protocol):
    """A medium that can be played from any time."""

    info: MediaInfo
    end_s: float
    flip_rows: bool
    notices: list[str]

    def lap(self, from_s: float, *, after: bool) -> Iterator[Decoded | str]:
        """Yield the pictures to the end: from the one shown at `from_s`, or the first that starts after it.

        Between them, lines for the user; an empty one only says that the source is alive.
        """


@dataclass(frozen=True)
class Sequence:
    """Consecutively numbered pictures."""

    start: int
    count: int
    rate: float


def is_wanted(picture_s: float, end_s: float, from_s: float, *, after: bool) -> bool:
    """Whether a picture shown from `picture_s` to `end_s` belongs to the lap that was asked for."""
    return picture_s > from_s + TIME_SLACK_S or (not after and end_s > from_s + TIME_SLACK_S)

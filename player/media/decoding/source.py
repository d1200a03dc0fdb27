"""The interface of all sources of decoded pictures: laps, and pictures with their times.

A lap is one pass from a given time to the end. Sources run only in the decoder process.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

from counterlight.media.decoding.pixels import Samples
from counterlight.media.frames import MediaInfo

TIME_SLACK_S = 1e-6  # far below a frame's duration, far above the rounding of a float64 time


class FormatChangedError(Exception):
    """A live source has changed the size or format of its pictures, and must be opened again."""


@dataclass(frozen=True)
class Decoded:
    """One picture of a medium.

    time_s : since the first picture.
    samples : valid until the next picture is requested.
    corrupt : whether FFmpeg has concealed damage; such a picture is dropped.
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
        """Yield the pictures to the end, starting with the picture shown at `from_s`.

        Also yields lines for the user. An empty line is only a sign of life.

        after : whether to start with the first picture that begins after `from_s`.
        """


@dataclass(frozen=True)
class Sequence:
    """Consecutively numbered pictures."""

    start: int
    count: int
    rate: float


def is_wanted(picture_s: float, end_s: float, from_s: float, *, after: bool) -> bool:
    """Whether a picture shown from `picture_s` to `end_s` belongs to the requested lap."""
    return picture_s > from_s + TIME_SLACK_S or (not after and end_s > from_s + TIME_SLACK_S)

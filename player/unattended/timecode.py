"""Linear timecode (LTC, SMPTE ST 12-1): 80 bits a frame as a square wave in a sound channel.

A bit is a time between two changes of the wave; a 1 has one more change in its middle. The lowest bit of each digit
comes first, and each frame ends with the sync word. It is read forwards, at half to twice its speed, at any level.
"""

from collections import deque
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

BITS = 80
SYNC = 0b0011111111111101  # the last 16 bits as they come
RATES = Fraction(24), Fraction(25), Fraction(30), Fraction(24000, 1001), Fraction(30000, 1001)
SHORTEST_HZ, LONGEST_HZ = 5000.0, 900.0  # of a bit: 30 frames a second at twice, 24 at half their speed
HALF_OF_BIT = 0.75  # between two changes: less is half a bit, more a whole one
TOUCH, LEVEL_S = 0.25, 0.01  # a change is believed behind this share of the level, which fades in so long
LOWEST_LEVEL = 1e-3  # of full scale: below is noise
FOLLOWED = 0.1  # how much of an interval's error the length of a bit takes over
MEASURED = 250  # frames over which their rate is measured
WOUND = 0.1  # off its speed by more than this, a tape does not say its rate
SURE_FRAMES = 30  # before 29.97 is told from 30
DIGITS = (0, 4, 10), (8, 2, 3), (16, 4, 10), (24, 3, 6), (32, 4, 10), (40, 3, 6), (48, 4, 10), (56, 2, 3)
DROP_FLAG = 10


@dataclass(frozen=True)
class Timecode:
    """A frame's label.  drop : whether labels 0 and 1 are left out of each minute but every tenth."""

    hours: int
    minutes: int
    seconds: int
    frames: int
    drop: bool = False

    def __str__(self) -> str:
        return f"{self.hours:02}:{self.minutes:02}:{self.seconds:02}{';' if self.drop else ':'}{self.frames:02}"

    def count(self, a_second: int) -> int:
        """Frames since 00:00:00:00.  a_second : of labels: 24, 25 or 30."""
        minutes = 60 * self.hours + self.minutes
        counted = (60 * minutes + self.seconds) * a_second + self.frames
        return counted - 2 * (minutes - minutes // 10) if self.drop else counted

    def seconds_at(self, rate: Fraction) -> float:
        """Seconds since 00:00:00:00 at so many frames a second."""
        return float(self.count(round(rate)) / rate)


@dataclass(frozen=True)
class Passed:
    """A frame whose last bit has come at sample `end`; whose frames last `samples`, as measured; None until known."""

    code: Timecode
    end: float
    samples: float | None


def parse_timecode(text: str) -> Timecode:
    """`HH:MM:SS`, `HH:MM:SS:FF` or, drop-frame, `HH:MM:SS;FF`; ValueError for what is none."""
    drop = ";" in text
    words = text.replace(";", ":").split(":")
    if len(words) not in (3, 4) or not all(word.isascii() and word.isdecimal() and len(word) == 2 for word in words):
        raise ValueError(text)
    hours, minutes, seconds, frames = (int(word) for word in (*words, "00")[:4])
    code = Timecode(hours, minutes, seconds, frames, drop)
    if not _is_label(code):
        raise ValueError(text)
    return code


class TimecodeReader:
    """Samples of one channel -> the frames in them.

    A frame is told when the one before it has the label before, so that no bit that was read wrongly makes time jump.
    """

    def __init__(self, samples_a_second: float) -> None:
        self._rate = samples_a_second
        self._shortest, self._longest = samples_a_second / SHORTEST_HZ, samples_a_second / LONGEST_HZ
        self._edges = _Edges(samples_a_second)
        self._begin()

    def _begin(self) -> None:
        self._bit: float | None = None  # samples of one
        self._changed: float | None = None  # where the wave did last
        self._half = False
        self._word, self._known = 0, 0
        self._last: tuple[Timecode, float] | None = None
        self._ends: deque[float] = deque(maxlen=MEASURED + 1)

    def feed(self, samples: NDArray[np.floating]) -> list[Passed]:
        """The frames whose last bit comes in these samples, which follow those of the call before."""
        return [passed for edge in self._edges.of(samples) if (passed := self._take(edge)) is not None]

    def _take(self, edge: float) -> Passed | None:
        """A change of the wave, at a sample."""
        if self._changed is None:
            self._changed = edge
            return None
        length, self._changed = edge - self._changed, edge
        if not self._shortest / 2 * 0.8 < length < self._longest * 1.2:
            self._begin()
            self._changed = edge
            return None
        bit = self._bit or length
        if length > 1.5 * bit or length < bit / 3:  # what was taken for a bit was half of one, or another speed
            bit, self._half, self._known = length, False, 0
        short = length < HALF_OF_BIT * bit
        self._bit = bit + FOLLOWED * ((2 * length if short else length) - bit)
        if short:
            self._half = not self._half
            return None if self._half else self._shift(1, edge)
        if self._half:  # a whole bit behind half of one: the count of halves was wrong
            self._half, self._known = False, 0
        return self._shift(0, edge)

    def _shift(self, bit: int, edge: float) -> Passed | None:
        self._word = (self._word << 1 | bit) & (1 << BITS) - 1
        self._known += 1
        if self._known < BITS or self._word & 0xFFFF != SYNC:
            return None
        code = _label(self._word)
        last, self._last = self._last, None if code is None else (code, edge)
        if code is None or last is None or not (_follows(code, last[0]) and self._lasts_a_frame(edge - last[1])):
            self._ends.clear()
            return None
        self._ends.append(edge)
        count = len(self._ends) - 1
        lasts = (self._ends[-1] - self._ends[0]) / count if count >= SURE_FRAMES else None
        return Passed(code, edge, lasts)

    def _lasts_a_frame(self, samples: float) -> bool:
        return self._bit is not None and abs(samples / self._bit - BITS) < BITS / 4


class _Edges:
    """Where a wave changes its sign, in samples since the first; noise and offsets are no changes."""

    def __init__(self, samples_a_second: float) -> None:
        self._fade = float(np.exp(-1 / (LEVEL_S * samples_a_second)))
        self._before, self._high, self._at = 0.0, 0.0, 0
        self._top = self._bottom = 0.0
        self._crossed = 0.0

    def of(self, samples: NDArray[np.floating]) -> list[float]:
        found, before, high = [], self._before, self._high
        top, bottom, crossed, fade = self._top, self._bottom, self._crossed, self._fade
        for index, value in enumerate(np.nan_to_num(np.asarray(samples, np.float64)).tolist(), self._at):
            middle = (top + bottom) / 2
            top = value if value > top else middle + (top - middle) * fade
            bottom = value if value < bottom else middle + (bottom - middle) * fade
            middle, reach = (top + bottom) / 2, (top - bottom) / 2
            if (before > middle) != (value > middle):
                crossed = index - 1 + (middle - before) / (value - before)
            beyond = value - middle if not high else middle - value
            if beyond > TOUCH * reach and reach > LOWEST_LEVEL:
                high = not high
                found.append(crossed)
            before = value
        self._before, self._high, self._at = before, high, self._at + len(samples)
        self._top, self._bottom, self._crossed = top, bottom, crossed
        return found


def nearest_rate(frames_a_second: float, *, drop: bool) -> Fraction | None:
    """The one of RATES that is meant; None where a tape is wound."""
    meant = min(RATES[4:] if drop else RATES, key=lambda rate: abs(float(rate) - frames_a_second))
    return meant if abs(frames_a_second / float(meant) - 1) < WOUND else None


def _label(word: int) -> Timecode | None:
    """Of the 80 bits of a frame, the first one the highest; None for what is none."""

    def number(first: int, count: int) -> int:
        return sum((word >> BITS - 1 - first - bit & 1) << bit for bit in range(count))

    values = [number(first, count) for first, count, _ in DIGITS]
    if any(value >= most for value, (_, _, most) in zip(values, DIGITS, strict=True)):
        return None
    frames, seconds, minutes, hours = (low + 10 * high for low, high in zip(values[::2], values[1::2], strict=True))
    code = Timecode(hours, minutes, seconds, frames, drop=bool(number(DROP_FLAG, 1)))
    return code if _is_label(code) else None


def _is_label(code: Timecode) -> bool:
    dropped = code.drop and code.frames < 2 and code.seconds == 0 and code.minutes % 10 != 0
    return code.hours < 24 and code.minutes < 60 and code.seconds < 60 and code.frames < 30 and not dropped


def _follows(code: Timecode, last: Timecode) -> bool:
    """Whether a label is the next one, whatever their rate; midnight behind the last of a day."""
    if code.drop != last.drop:
        return False
    if code.frames == last.frames + 1:
        return (code.hours, code.minutes, code.seconds) == (last.hours, last.minutes, last.seconds)
    second = 3600 * code.hours + 60 * code.minutes + code.seconds
    before = 3600 * last.hours + 60 * last.minutes + last.seconds
    return last.frames in (23, 24, 29) and code.frames in (0, 2) and (second - before) % 86400 == 1

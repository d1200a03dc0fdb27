"""Plays one medium against a clock: due frames, pause, seek, step, speed, A-B loop. Knows no renderer and no window."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from counterlight.media.audio import Track
from counterlight.media.frames import Frame
from counterlight.media.video import MediaReader
from counterlight.show.pacing import Pace

MORE_THAN_ROUNDING_S = 1e-3
# share of a frame's duration; a frame that reaches into a group by less than this belongs to the previous group
ROUNDING = 0.25
TOLERATED_S = 0.02  # tolerated delay at any frame rate
DECODER_WAIT_S = 0.002  # poll interval while a decoder is behind
HELD_S = 0.25  # how long a late frame is held back for a newer frame
HURRIED_S = 2.0  # seconds in which no frame is held back, after a frame was held back without effect


@dataclass
class Manner:
    """How media are played. The user's settings last across media and apply before the first medium."""

    loop: bool
    speed: float
    paused: bool = False


class Playback:
    """Returns the frame that is due: the last frame whose time has come. Drops and counts earlier frames.

    A slow renderer would find only old frames in the reader's ring, older each time. Therefore the decoder skips frames
    that will be over before the next request. A frame that still comes too late is held back until a newer frame
    arrives. Media time waits for a decoder that is too slow; `stalled_s` counts this time.

    reader : the open medium.
    clock : seconds, monotonic.
    loop : whether the medium starts again at its end.
    seamless : whether the reader itself starts again at the end, as long as `loop` stays on.
    hold_s : how long a still is shown; None for no limit.
    paused : whether the medium begins paused.
    speed : media seconds per second.
    sound : the medium's sound. While it is heard, its clock determines media time.
    begins_s : clock time at which the first frame is due on the screen; None for as soon as possible.
    pace : shows one frame of each of its groups; None for every frame.
    """

    def __init__(
        self,
        reader: MediaReader,
        clock: Callable[[], float],
        *,
        loop: bool = False,
        seamless: bool = False,
        hold_s: float | None = None,
        paused: bool = False,
        speed: float = 1.0,
        sound: Track | None = None,
        begins_s: float | None = None,
        pace: Pace | None = None,
    ) -> None:
        self.reader, self.pace, self.loop, self.hold_s = reader, pace, loop, hold_s
        self.dropped = 0
        self.stalled_s = 0.0
        self.a_s: float | None = None
        self.b_s: float | None = None
        self._clock, self._seamless, self._sound = clock, seamless, sound
        self._lap_s = 0.0  # media time at which the present lap began
        self._pending: Frame | None = None
        # clock time and media time of one moment; None until a frame arrives
        self._anchor: tuple[float, float] | None = None
        self._taken_s: float | None = None  # time of the frame taken last.
        self._shown_s: float | None = None  # time of the frame returned last
        self._taken_until_s = self._seconds = 0.0
        self._paused, self._speed = paused, speed
        self._begins_s = begins_s
        self._wanted = True  # a frame is wanted even during a pause: the first frame, or the frame of a seek or step
        self._cut_off = False
        self._held: Frame | None = None  # a late frame, shown only if no newer frame arrives
        self._held_since_s: float | None = None
        self._hurried_until_s = float("-inf")
        self._skipped_to_s = 0.0
        self._left_s: float | None = None  # clock time at which the last frame was returned
        self._absences_s = 0.0, 0.0  # the last two times from returning a frame to the next call

    @property
    def position_s(self) -> float:
        """Time of the frame taken last, within the medium. During a seek, the time that was sought."""
        return self._seconds

    @property
    def media_s(self) -> float | None:
        """Media time now, which grows across loops. None until a frame has come."""
        return self._media_time()

    @property
    def now_s(self) -> float | None:
        """Media time now, within the medium. None until a frame has come."""
        now_s = self._media_time()
        return None if now_s is None else self._in_medium(now_s)

    @property
    def is_heard(self) -> bool:
        return self._sound is not None and self._sound.time_s() is not None

    def shift(self, seconds: float) -> None:
        """Shift media time. Frames that are over are dropped; frames that are not yet due are waited for."""
        self._hold_now()
        if self._anchor is None:
            return
        clock_s, media_s = self._anchor
        self._anchor = clock_s, media_s + seconds
        if self._sound is not None:
            self._sound.seek(self._in_medium(media_s + seconds), self._speed)
            self._let_hear()

    @property
    def paused(self) -> bool:
        return self._paused

    @paused.setter
    def paused(self, paused: bool) -> None:
        self._hold_now()
        self._paused = paused
        self._let_hear()

    @property
    def speed(self) -> float:
        return self._speed

    @speed.setter
    def speed(self, speed: float) -> None:
        self._hold_now()
        self._speed = speed
        if self._sound is not None:
            self._sound.seek(self._in_medium(self._media_time() or self._seconds), speed)
            self._let_hear()

    @property
    def finished(self) -> bool:
        """Whether the last frame has been shown for its duration. A still lasts `hold_s`."""
        if self._wanted and not self._exhausted:
            return False
        now_s, end_s = self._media_time(), self._end_s
        if self._cut_off or now_s is None:
            return self._cut_off or (self._exhausted and not self.reader.info.still)
        return end_s is not None and now_s >= end_s

    @property
    def ended_at_s(self) -> float | None:
        """Clock time at which the last frame has been shown for its duration. None while unknown, paused or cut off."""
        if self._anchor is None or self._end_s is None or self._cut_off or self._paused:
            return None
        clock_s, media_s = self._anchor
        return clock_s + (self._end_s - media_s) / self._speed

    @property
    def _end_s(self) -> float | None:
        """Media time at which the last frame has been shown for its duration. None while unknown."""
        if self.reader.info.still:
            return self.hold_s
        return self._taken_until_s if self._exhausted else None

    def ends_within(self, seconds: float, *, unknown: bool = False) -> bool:
        """Whether the end comes within `seconds`.

        seconds : clock time from now on.
        unknown : result for a medium of unknown length.
        """
        info, ahead_s = self.reader.info, seconds * self._speed
        if self._paused or info.live or self.loops:
            return False
        if info.still:
            now_s = self._media_time()
            return self.hold_s is not None and now_s is not None and now_s + ahead_s >= self.hold_s
        return unknown if info.duration_s is None else self._seconds + ahead_s >= info.duration_s

    def due(self) -> Frame | None:
        """Return the newest frame that is due, None if there is none. Drops and counts older frames."""
        if self._paused and not self._wanted:
            return None
        self._came_back()
        due = self._newest()
        if due is not None and self._comes_too_late(due):
            self._held = due
            return None
        self._held_since_s = None
        if due is not None:
            self._leave(due)
        elif self._exhausted and self.finished and not self.reader.info.still and self.loops:
            self.seek(self._ab[0] if self._ab else self.a_s or 0.0)
        return due

    @property
    def loops(self) -> bool:
        """Whether the medium starts again: `loop` is on, or points A and B are set."""
        return self.loop or self._ab is not None

    @property
    def _ab(self) -> tuple[float, float] | None:
        """The beginning and end of the A-B loop. As in mpv, the points may be set in either order."""
        if self.a_s is None or self.b_s is None:
            return None
        return min(self.a_s, self.b_s), max(self.a_s, self.b_s)

    def due_at(self, frame: Frame) -> float | None:
        """Return the clock time at which a frame is due on the screen, None while paused."""
        if self._anchor is None or self._paused:
            return None
        clock_s, media_s = self._anchor
        return clock_s + (frame.time_s - media_s) / self._speed

    def wait_s(self, longest_s: float) -> float:
        """Return the seconds until something is due, at most `longest_s`, unless a command comes first."""
        self._came_back()
        if self._paused and not self._wanted:
            return longest_s
        now_s, next_s = self._media_time(), self._end_s if self._pending is None else self._pending.time_s
        if now_s is None or next_s is None:
            return longest_s if self.reader.ended and not self._wanted else min(DECODER_WAIT_S, longest_s)
        if self._pending is None and now_s >= next_s:  # the medium has ended
            return longest_s
        return min(max((next_s - now_s) / self._speed, 0.0), longest_s)

    def seek(self, time_s: float) -> None:
        """Continue with the frame that is shown at `time_s` of the medium. Live sources ignore a seek."""
        if self.reader.info.live:
            return
        self._drop_pending()
        self._skipped_to_s = self._lap_s = 0.0
        self._left_s = None
        self._seconds = self._in_medium(min(max(0.0, time_s), self.reader.info.duration_s or float("inf")))
        self.reader.seek(self._seconds)
        if self._sound is not None:
            self._sound.seek(self._seconds, self._speed)
        self._anchor = self._taken_s = self._shown_s = None
        self._wanted, self._cut_off = True, False

    def end(self) -> None:
        """End the medium as after its last frame. A seek resumes it."""
        self._drop_pending()
        self._cut_off, self._wanted = True, False

    def refresh(self) -> None:
        """Request the frame on the screen again."""
        self.seek(self._seconds)

    def step(self, direction: int) -> None:
        """Pause on the next frame (1) or the previous frame (-1)."""
        self.paused = True
        if direction > 0:
            self._wanted = True
        else:
            self.seek(self._seconds - MORE_THAN_ROUNDING_S)

    def close(self) -> None:
        self._drop_pending()
        self.reader.close()
        if self._sound is not None:
            self._sound.close()

    @property
    def _exhausted(self) -> bool:
        return self.reader.ended and self._pending is None and self._held is None

    def _newest(self) -> Frame | None:
        """Take every frame whose time has come, and return the last of them."""
        due, self._held = self._held, None
        while self._fetch() and not self._cut_off:
            pending = self._pending
            assert pending is not None
            if self._anchor is None or (self._paused and self._wanted) or self._is_early(pending):
                self._begin_at(pending)
                self._wanted = False
            if not self._has_come(pending.time_s) or self._leaves_loop(pending):
                break
            if self._is_left_out(pending):
                self.reader.release(pending)
                self.dropped, self._pending = self.dropped + 1, None
                self._took(pending)
                continue
            if due is not None:
                self.reader.release(due)
                self.dropped += 1
            due, self._pending = pending, None
            self._took(pending)
        return due

    def _is_left_out(self, frame: Frame) -> bool:
        """Whether another frame of the same group has been shown. The medium's last frame is never left out."""
        if self.pace is None or self.pace.every == 1 or self._paused or self._shown_s is None:
            return False
        end_s = math.inf if self._seamless else self.reader.info.duration_s or math.inf
        if self.reader.ended or frame.time_s + 1.5 * frame.duration_s >= end_s:
            return False
        return self.pace.group(frame.time_s) == self.pace.group(self._shown_s)

    def _is_early(self, frame: Frame) -> bool:
        """Whether a live frame comes before its time. Earlier frames were then delayed by the difference."""
        return self.reader.info.live and not self._paused and not self._has_come(frame.time_s)

    def _comes_too_late(self, frame: Frame) -> bool:
        """Whether to wait for a newer frame, because this frame is over and the next frame has not been decoded."""
        now_s = self._media_time()
        if self._paused or self._pending is not None or self.reader.ended or self._cut_off or now_s is None:
            return False
        late_s, clock_s = now_s - frame.time_s, self._clock()
        if late_s <= max(frame.duration_s, TOLERATED_S * self._speed):
            return False
        if self._held_since_s is None:
            self._held_since_s = clock_s
        if clock_s >= self._hurried_until_s and clock_s - self._held_since_s < HELD_S:
            self._skip_to(now_s, frame.duration_s)
            return True
        if clock_s >= self._hurried_until_s:
            self._hurried_until_s = clock_s + HURRIED_S
        self.stalled_s += late_s / self._speed
        self._put_anchor(frame.time_s)
        return False

    def _leave(self, frame: Frame) -> None:
        """Record that a frame is returned, and let the decoder skip frames that will be over by the next request."""
        self._left_s, self._shown_s = self._clock(), frame.time_s
        if self.pace is not None and self.pace.every > 1 and not self._paused:
            self._skip_to(self.pace.next_s(frame.time_s) + ROUNDING * frame.duration_s, frame.duration_s)
        absence_s, now_s = min(self._absences_s) * self._speed, self._media_time()
        if now_s is not None and not self._paused and absence_s > 2 * frame.duration_s:
            self._skip_to(now_s + absence_s - frame.duration_s, frame.duration_s)

    def _came_back(self) -> None:
        if self._left_s is not None:
            self._absences_s, self._left_s = (self._absences_s[1], self._clock() - self._left_s), None

    def _skip_to(self, time_s: float, duration_s: float) -> None:
        """Let the decoder skip frames that end before `time_s`, but never the medium's last frame."""
        end_s = self.reader.info.duration_s
        if end_s is not None and not self._seamless:
            time_s = min(time_s, end_s - 2 * duration_s)
        if time_s >= self._skipped_to_s + duration_s:
            self._skipped_to_s = time_s
            self.reader.skip(time_s)

    def _fetch(self) -> bool:
        if self._pending is None:
            self._pending = self.reader.poll()
            self.dropped += self._pending.skipped if self._pending is not None else 0
        return self._pending is not None

    def _took(self, frame: Frame) -> None:
        self._wanted = False
        self._begin_lap(frame.time_s - self._in_medium(frame.time_s))
        self._taken_s, self._taken_until_s = frame.time_s, frame.time_s + frame.duration_s
        self._seconds = self._in_medium(frame.time_s)

    def _begin_lap(self, lap_s: float) -> None:
        """Restart the sound when the reader has started the medium again."""
        if abs(lap_s - self._lap_s) > MORE_THAN_ROUNDING_S:
            self._media_time()  # updates the anchor before the sound stops
            self._lap_s = lap_s
            if self._sound is not None:
                self._sound.seek(0.0, self._speed)
                self._let_hear()

    def _in_medium(self, time_s: float) -> float:
        """Convert a time that grows across loops into a time within the medium."""
        duration_s = self.reader.info.duration_s
        return time_s % duration_s if self._seamless and duration_s else time_s

    def _leaves_loop(self, frame: Frame) -> bool:
        """Go to A after point B. End the medium if its reader has started it again although `loop` is now off."""
        if self._taken_s is None:
            return False
        here_s, there_s = self._in_medium(self._taken_s), self._in_medium(frame.time_s)
        again = there_s < here_s
        if self._ab is not None and here_s <= self._ab[1] and (there_s >= self._ab[1] or again):
            self.seek(self._ab[0])
            return True
        if again and self._seamless and not self.loop:
            self._cut_off = True
            return True
        return False

    def _media_time(self) -> float | None:
        if self._anchor is None:
            return None
        heard_s = None if self._sound is None or self._paused else self._sound.time_s()
        if heard_s is not None:
            self._anchor = self._clock(), self._lap_s + heard_s
        clock_s, media_s = self._anchor
        return media_s if self._paused else media_s + (self._clock() - clock_s) * self._speed

    def _begin_at(self, frame: Frame) -> None:
        """Anchor the media time of a frame to the present, or to `begins_s` if that was less than a frame ago."""
        begins_s, self._begins_s, now_s = self._begins_s, None, self._clock()
        late_s = 0.0 if begins_s is None else now_s - begins_s
        self._anchor = now_s - late_s if 0 < late_s < frame.duration_s else now_s, frame.time_s
        self._let_hear()

    def _put_anchor(self, media_s: float) -> None:
        self._anchor = self._clock(), media_s
        self._let_hear()

    def _let_hear(self) -> None:
        """Play or pause the sound according to the anchor."""
        if self._sound is None:
            return
        if self._paused or self._anchor is None:
            self._sound.pause()
        else:
            clock_s, media_s = self._anchor
            self._sound.play(media_s - self._lap_s, clock_s)

    def _has_come(self, time_s: float) -> bool:
        now_s = self._media_time()
        return now_s is not None and time_s <= now_s

    def _hold_now(self) -> None:
        """Anchor the present media time before its rate changes."""
        now_s = self._media_time()
        if now_s is not None:
            self._anchor = self._clock(), now_s

    def _drop_pending(self) -> None:
        for frame in (self._pending, self._held):
            if frame is not None:
                self.reader.release(frame)
        self._pending = self._held = self._held_since_s = None

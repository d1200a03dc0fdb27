"""Synchronises shows: followers go to the leader's position, or each show begins at the same time of day."""

import time
from collections.abc import Callable
from datetime import datetime
from statistics import median
from typing import Any

from counterlight.show.playback import Playback
from counterlight.show.session import Session
from counterlight.unattended.cues import Beacon, Cue, Heard, Listener

FAR_S = 1.0  # error above which a follower seeks; with a smaller error it shifts media time
# largest errors that are left alone; with sound, a correction would be audible
CLOSE_S, CLOSE_WITH_SOUND_S = 0.002, 0.03
PUT_RIGHT_S, SEEK_S = 0.5, 2.0  # shortest time between two shifts, and between two seeks
OTHER_ITEM_S, AGAIN_S = 0.5, 10.0  # how long the leader plays an item before it is selected; pause between attempts
LONGEST_SEEK_S = 5.0
LATEST_START_S = 5.0  # largest delay that is made up for if the first medium opened late


class Leader:
    def __init__(self, session: Session, beacon: Beacon) -> None:
        self._session, self._beacon = session, beacon
        session.stats.facts["in_step"] = {"role": "lead"}

    def poll(self) -> None:
        self._beacon.tell(cue_of(self._session))


def cue_of(session: Session) -> Cue:
    """Return the position of a show now."""
    playback, at_s = session.playback, session.clock()
    if playback is None or session.programme.over:
        return Cue(at_s=at_s)
    now_s, paused = playback.now_s, playback.paused
    media_s = playback.position_s if now_s is None or paused else now_s
    return Cue(session.programme.on, media_s, at_s, playback.speed, paused, now_s is not None and not paused)


class Follower:
    """Follows the leader's item, pause, speed and time. While the leader is silent, the show continues alone."""

    def __init__(self, session: Session, listener: Listener) -> None:
        self._session, self._listener = session, listener
        self._in_touch = False
        self._other: tuple[int, float] | None = None  # an item that only the leader plays, and since when
        self._tried: tuple[int, float] | None = None  # the item selected last, and when
        self._stood: tuple[int, float] | None = None  # item and media time at which the leader was paused
        self._sought_at_s, self._seek_takes_s = float("-inf"), 0.0
        self._seeks = False  # whether a seek has not yet produced a frame
        self._errors: list[float] = []
        self._put_right_at_s = float("-inf")

    def poll(self) -> None:
        heard, playback = self._listener.heard, self._session.playback
        self._tell(heard)
        if heard is None or not self._plays(heard.cue) or playback is None:
            return
        info, cue = playback.reader.info, heard.cue
        if playback.speed != cue.speed:
            playback.speed = cue.speed
        if cue.paused:
            self._stand(playback, cue)
            return
        self._stood = None
        if playback.paused:
            playback.paused = False
        if cue.moving and playback.now_s is not None and not (info.still or info.live):
            leader_s = self._session.clock() + heard.offset_s
            self._keep_up(playback, cue.media_s + (leader_s - cue.at_s) * cue.speed)

    def _tell(self, heard: Heard | None) -> None:
        in_touch = heard is not None
        if in_touch != self._in_touch:
            self._in_touch = in_touch
            self._session.notice("in touch with the leader" if in_touch else "the leader is silent; going on alone")
        state: dict[str, Any] = {"role": "follow", "in_touch": in_touch}
        if heard is not None:
            state["round_trip_ms"] = round(1000 * heard.round_trip_s, 3)
        self._session.stats.facts["in_step"] = self._session.stats.facts.get("in_step", {}) | state

    def _plays(self, cue: Cue) -> bool:
        """Whether this show plays the leader's item. Selects the item if the difference lasts."""
        session, now_s = self._session, self._session.clock()
        if cue.item == session.programme.on and not session.programme.over:
            self._other = None
            return True
        if self._other is None or self._other[0] != cue.item:
            self._other = cue.item, now_s
        lasts = now_s - self._other[1] >= OTHER_ITEM_S and session.playlist.position != cue.item
        tried = self._tried is not None and self._tried[0] == cue.item and now_s - self._tried[1] < AGAIN_S
        if cue.item >= 0 and lasts and not tried:
            self._tried = cue.item, now_s
            self._go_to(cue.item)
        return False

    def _go_to(self, item: int) -> None:
        session = self._session
        if item < len(session.playlist.media):
            session.programme.select(item)
        else:
            session.notice(f"the leader plays medium {item + 1}, this list ends before; give both the same list")

    def _stand(self, playback: Playback, cue: Cue) -> None:
        """Pause on the leader's frame."""
        if not playback.paused:
            playback.paused = True
        if (cue.item, cue.media_s) != self._stood:
            self._stood = cue.item, cue.media_s
            playback.seek(cue.media_s)
        self._errors.clear()

    def _keep_up(self, playback: Playback, target_s: float) -> None:
        error_s, clock_s = _behind(playback, target_s), self._session.clock()
        if error_s is None:
            return
        if self._seeks:  # the first frame after a seek shows how long the seek took
            self._seek_takes_s = min(max(self._seek_takes_s + error_s, 0.0), LONGEST_SEEK_S)
            self._seeks, self._put_right_at_s = False, float("-inf")
        if abs(error_s) <= FAR_S:
            self._put_right(playback, error_s)
        elif clock_s - self._sought_at_s >= SEEK_S:
            self._seeks, self._sought_at_s = True, clock_s
            self._errors.clear()
            playback.seek(_within(playback, target_s + self._seek_takes_s * playback.speed))

    def _put_right(self, playback: Playback, error_s: float) -> None:
        """Shift media time by the median of the recent errors."""
        self._errors.append(error_s)
        clock_s = self._session.clock()
        if clock_s - self._put_right_at_s < PUT_RIGHT_S:
            return
        usual_s, self._put_right_at_s = median(self._errors), clock_s
        self._errors.clear()
        self._session.stats.facts["in_step"] |= {"error_ms": round(1000 * usual_s, 3)}
        if abs(usual_s) > (CLOSE_WITH_SOUND_S if playback.is_heard else CLOSE_S):
            playback.shift(usual_s)


class Curtain:
    """Starts a show at a time of day. Until then the picture is black, and the medium is paused on its first frame."""

    def __init__(self, session: Session, begins: datetime, clock: Callable[[], float] = time.time) -> None:
        self._session, self._begins_s, self._clock = session, begins.timestamp(), clock
        self._before = session.blackout, session.manner.paused
        self._down = self._late_s < 0
        self._starts = self._down
        if self._down:
            session.blackout = True
            session.notice(f"begins at {begins:%H:%M:%S}")

    def poll(self) -> None:
        session, late_s = self._session, self._late_s
        if self._down and late_s < 0:
            session.manner.paused = True
        elif self._down:
            self._down = False
            session.blackout, session.manner.paused = self._before
            session.changed()
        if self._starts and late_s >= 0 and session.playback is not None and session.playback.now_s is not None:
            self._starts = False
            if late_s < LATEST_START_S:
                session.playback.shift(late_s * session.playback.speed)

    @property
    def _late_s(self) -> float:
        """Seconds since the planned beginning; negative before it."""
        return self._clock() - self._begins_s


def _behind(playback: Playback, target_s: float) -> float | None:
    """Return how many seconds media time is behind a target, None beyond the medium's end.

    If the medium loops, the result is the shortest way around the loop.
    """
    assert playback.now_s is not None
    error_s, duration_s = target_s - playback.now_s, playback.reader.info.duration_s
    if not duration_s:
        return error_s
    if playback.loops:
        return (error_s + duration_s / 2) % duration_s - duration_s / 2
    return error_s if target_s < duration_s else None


def _within(playback: Playback, time_s: float) -> float:
    duration_s = playback.reader.info.duration_s
    return time_s % duration_s if duration_s and playback.loops else time_s

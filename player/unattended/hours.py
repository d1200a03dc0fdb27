"""When a show plays, by day and hour of the week, and the projectors that are switched for it."""

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import date, datetime, time, timedelta
from time import monotonic

from counterlight.command import tell
from counterlight.errors import InputError
from counterlight.unattended.pjlink import Projector, status_of, switch

DAYS = ("mon", "tue", "wed", "thu", "fri", "sat", "sun")
AHEAD_DAYS = 366  # days in which the next hours are sought
LOOK_S, AGAIN_S = 600.0, 10.0  # time between two queries of a projector, and of a projector that has not yet obeyed


@dataclass(frozen=True)
class Hours:
    """Daily hours from `begin` to `end`, on the weekdays `days` (0 is Monday) when they begin.

    An `end` that is not after `begin` is on the next day.
    """

    days: frozenset[int]
    begin: time
    end: time

    def cover(self, now: datetime, closed: frozenset[date]) -> bool:
        return any(self._from(now.date() - timedelta(days=before), now, closed) for before in (0, 1))

    def begins(self, day: date, closed: frozenset[date]) -> bool:
        return day.weekday() in self.days and day not in closed

    def _from(self, day: date, now: datetime, closed: frozenset[date]) -> bool:
        if not self.begins(day, closed):
            return False
        last = day if self.end > self.begin else day + timedelta(days=1)
        return datetime.combine(day, self.begin) <= now < datetime.combine(last, self.end)


@dataclass(frozen=True)
class Schedule:
    """When a show plays.

    hours : hours of the show; None for a show that always plays.
    closed : days on which no interval begins.
    projectors : projectors to switch for the show.
    ahead : how long before the show the projectors are switched on.
    """

    hours: tuple[Hours, ...] | None
    closed: frozenset[date] = frozenset()
    projectors: tuple[Projector, ...] = ()
    ahead: timedelta = timedelta(minutes=2)

    def plays(self, now: datetime) -> bool:
        return self.hours is None or any(each.cover(now, self.closed) for each in self.hours)

    def opens(self, now: datetime) -> datetime | None:
        """Return when the hours begin next after `now`; None if they do not within a year."""
        days = [now.date() + timedelta(days=ahead) for ahead in range(AHEAD_DAYS)]
        hours = self.hours or ()
        begins = [datetime.combine(day, each.begin) for day in days for each in hours if each.begins(day, self.closed)]
        return min((begin for begin in begins if begin > now), default=None)

    def lit(self, now: datetime) -> bool:
        """Whether the projectors should be on."""
        return self.plays(now) or self.plays(now + self.ahead)


class Keeper:
    """Switches projectors by a schedule and prints their state. Each projector has its own thread.

    A projector gets each order only until it obeys. Later switching by hand is respected. A changed schedule is
    followed at once, even if the projector has not yet obeyed.

    schedule : returns the present schedule. The projectors are read from it once.
    """

    def __init__(self, schedule: Callable[[], Schedule], clock: Callable[[], datetime] = datetime.now) -> None:
        self._schedule, self._clock = schedule, clock
        self._obeyed: dict[Projector, bool] = {}
        self._told: dict[Projector, str] = {}
        self._closed = threading.Event()
        self._threads = [
            threading.Thread(target=self._keep, args=(projector,), name=f"{projector}", daemon=True)
            for projector in schedule().projectors
        ]
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        self._closed.set()

    def _keep(self, projector: Projector) -> None:
        looked, again_s = self._clock(), 0.0
        wanted: bool | None = None
        while not self._closed.is_set():
            now = self._clock()
            on = self._schedule().lit(now)
            due = not timedelta(0) <= now - looked < timedelta(seconds=LOOK_S)
            waited = self._obeyed.get(projector) != on and monotonic() >= again_s
            if due or waited or on != wanted:
                looked, wanted, again_s = now, on, monotonic() + AGAIN_S
                self._look(projector, on)
            self._closed.wait(min(1.0, AGAIN_S))

    def _look(self, projector: Projector, on: bool) -> None:
        """Query a projector, send the order that is still missing, and print a changed status."""
        try:
            status = status_of(projector)
            if self._obeyed.get(projector) != on:
                if status.power == ("on" if on else "off"):
                    self._obeyed[projector] = on
                else:
                    self._obeyed.pop(projector, None)  # the projector no longer obeys its last order
                    if status.settled:
                        switch(projector, on=on)
            news = f"{replace(status, lamp_hours=())}"  # without lamp hours, because they always grow
            line = f"projector {projector}: {status}"
        except InputError as error:
            news = line = str(error)
        if self._told.get(projector) != news:
            self._told[projector] = news
            tell(line)


def days_of(names: Sequence[str]) -> frozenset[int]:
    return frozenset(DAYS.index(name) for name in names)


def begins_at(words: str, now: datetime) -> datetime:
    """Return the occurrence of `20:00:00` or `20:00` nearest to `now`, up to twelve hours before or after it.

    Raises ValueError if `words` is no time of day.
    """
    said = datetime.strptime(words, "%H:%M:%S" if words.count(":") == 2 else "%H:%M")
    today = now.replace(hour=said.hour, minute=said.minute, second=said.second, microsecond=0)
    if today - now > timedelta(hours=12):
        return today - timedelta(days=1)
    return today + timedelta(days=1) if now - today > timedelta(hours=12) else today

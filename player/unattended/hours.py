"""When a show plays, by the days and hours of the week, and projectors that are switched on and off for it."""

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import date, datetime, time, timedelta

from counterlight.command import tell
from counterlight.errors import InputError
from counterlight.unattended.pjlink import Projector, status_of, switch

DAYS = ("mon", "tue", "wed", "thu", "fri", "sat", "sun")
LOOK_S, AGAIN_S = 600.0, 10.0  # between looks at a projector, and at one that has not obeyed yet


@dataclass(frozen=True)
class Hours:
    """From one time of the day to another, on the next day if that is not later, on the days that it begins on."""

    days: frozenset[int]
    begin: time
    end: time

    def cover(self, now: datetime, closed: frozenset[date]) -> bool:
        return any(self._from(now.date() - timedelta(days=before), now, closed) for before in (0, 1))

    def _from(self, day: date, now: datetime, closed: frozenset[date]) -> bool:
        if day.weekday() not in self.days or day in closed:
            return False
        last = day if self.end > self.begin else day + timedelta(days=1)
        return datetime.combine(day, self.begin) <= now < datetime.combine(last, self.end)


@dataclass(frozen=True)
class Schedule:
    """hours : None for always.  closed : days on which nothing begins.

    ahead : how long before the show projectors are switched on.
    """

    hours: tuple[Hours, ...] | None
    closed: frozenset[date] = frozenset()
    projectors: tuple[Projector, ...] = ()
    ahead: timedelta = timedelta(minutes=2)

    def plays(self, now: datetime) -> bool:
        return self.hours is None or any(each.cover(now, self.closed) for each in self.hours)

    def lit(self, now: datetime) -> bool:
        """Whether projectors are to be on."""
        return self.plays(now) or self.plays(now + self.ahead)


class Keeper:
    """Switches projectors on and off by a schedule, each by a thread of its own, and tells how they are.

    Told once, until it has obeyed: who switches a projector by hand meanwhile has his reasons.
    schedule : as it is when asked; the projectors are those of the first time.
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
        looked: datetime | None = None
        while not self._closed.is_set():
            now = self._clock()
            on = self._schedule().lit(now)
            due = looked is None or not timedelta(0) <= now - looked < timedelta(seconds=LOOK_S)
            if due or self._obeyed.get(projector) != on:
                looked = now
                self._look(projector, on)
            obeyed = self._obeyed.get(projector) == on
            self._closed.wait(1.0 if obeyed else AGAIN_S)

    def _look(self, projector: Projector, on: bool) -> None:
        """One step towards what is wanted, and a line about what is new."""
        try:
            status = status_of(projector)
            if self._obeyed.get(projector) != on:
                if status.power == ("on" if on else "off"):
                    self._obeyed[projector] = on
                else:
                    self._obeyed.pop(projector, None)  # what it obeyed before, it no longer does
                    if status.settled:
                        switch(projector, on=on)
            news = f"{replace(status, lamp_hours=())}"  # hours always grow
            line = f"projector {projector}: {status}"
        except InputError as error:
            news = line = str(error)
        if self._told.get(projector) != news:
            self._told[projector] = news
            tell(line)


def days_of(names: Sequence[str]) -> frozenset[int]:
    return frozenset(DAYS.index(name) for name in names)

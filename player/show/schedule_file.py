"""The schedule file: when a show plays, and which projectors it uses (docs/unattended.md)."""

import shlex
import threading
from datetime import date, datetime, time, timedelta
from pathlib import Path
from typing import Any

from counterlight.command import tell
from counterlight.errors import InputError, shown
from counterlight.files.reading import read_toml
from counterlight.files.tables import Table
from counterlight.unattended.cues import read_address
from counterlight.unattended.hours import DAYS, Hours, Schedule, days_of
from counterlight.unattended.pjlink import PORT, Projector

FORMAT, FIX = 1, "docs/unattended.md shows such a file"
MOST_HOURS, MOST_PROJECTORS, MOST_CLOSED = 100, 16, 1000


def read_schedule(path: Path) -> Schedule:
    """Read a schedule. Raises InputError if the file is not a valid schedule."""
    file = Table(read_toml(path, FIX), f"{path}", FIX)
    file.format(FORMAT)
    file.raw("format", FORMAT)
    hours = tuple(_hours(entry) for entry in file.tables("hours", MOST_HOURS)) if "hours" in file else None
    projectors = file.tables("projectors", MOST_PROJECTORS) if "projectors" in file else []
    closed = frozenset(_day(file, value) for value in _listed(file, "closed", MOST_CLOSED))
    ahead = timedelta(minutes=file.number("minutes-ahead", 2.0, 0, 120))
    schedule = Schedule(hours, closed, tuple(map(_projector, projectors)), ahead)
    file.refuse_unknown()
    return schedule


class ScheduleFile:
    """A schedule that is read again whenever its file has changed. A damaged file changes nothing."""

    def __init__(self, path: Path) -> None:
        self._path, self._changed, self._schedule = path, _changed(path), read_schedule(path)
        if path.stat().st_mode & 0o077 and any(projector.password for projector in self._schedule.projectors):
            tell(f"{path}: other users can read its passwords; restrict it: chmod 600 {shlex.quote(str(path))}")
        self._lock = threading.Lock()

    def __call__(self) -> Schedule:
        """Return the present schedule. Any thread may call this."""
        with self._lock:
            changed = _changed(self._path)
            if changed not in (None, self._changed):
                self._changed = changed
                self._read()
            return self._schedule

    def _read(self) -> None:
        try:
            self._schedule = read_schedule(self._path)
            tell(f"{self._path}: read again")
        except InputError as error:
            tell(f"{error}; the hours stay as they were")


def _changed(path: Path) -> tuple[int, int] | None:
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_mtime_ns, status.st_ino


def _hours(entry: Table) -> Hours:
    names = _listed(entry, "days", len(DAYS)) if "days" in entry else list(DAYS)
    if not names or not all(name in DAYS for name in names):
        raise entry.wrong("days", f"a list of {', '.join(DAYS)}")
    made = Hours(days_of(names), _time(entry, "from"), _time(entry, "to"))
    entry.refuse_unknown()
    return made


def _projector(entry: Table) -> Projector:
    try:
        host, port = read_address(entry.text("address"), port=PORT)
    except ValueError:
        raise entry.wrong("address", "HOST or HOST:PORT") from None
    made = Projector(host, port, entry.text("password", ""))
    entry.refuse_unknown()
    return made


def _time(table: Table, key: str) -> time:
    """Read a time: `"20:00"`, `"20:00:30"`, or a TOML time."""
    value = table.raw(key, None)
    if isinstance(value, time):
        return value
    for form in ("%H:%M", "%H:%M:%S"):
        try:
            return datetime.strptime(value, form).time()
        except (TypeError, ValueError):
            continue
    raise table.wrong(key, 'a time such as "20:00"')


def _day(file: Table, value: Any) -> date:
    if isinstance(value, date) and not isinstance(value, datetime):
        return value
    try:
        return date.fromisoformat(value)
    except (TypeError, ValueError):
        raise file.refusal(f", closed: found {shown(value)}, expected a day such as 2026-12-24") from None


def _listed(table: Table, key: str, most: int) -> list[Any]:
    value = table.raw(key, [])
    if not isinstance(value, list) or len(value) > most:
        raise table.wrong(key, f"a list of at most {most}")
    return value

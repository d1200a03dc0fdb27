"""Decides what plays next: the playlist, the medium that is being opened, and retries after failures.

No method waits. No medium, list or remote command can end a lasting show: a medium that cannot be played is skipped.
Each of its faults is reported once, until it plays to its end. If no medium of a list plays, the list is tried again
after 1 s, 2 s, 4 s … 30 s.
"""

import random
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

from counterlight.errors import InputError
from counterlight.media.medium import Medium
from counterlight.media.video import MediaReader
from counterlight.show.lookup import LookUp
from counterlight.show.media import Media
from counterlight.show.playlist import Playlist, is_list
from counterlight.unattended.waiting import LONGEST_RETRY_S, retry_s

LOOK_S = 0.1  # how long a command waits for the disk; later errors appear when the medium is opened
LIST_S = 10.0  # longest time that reading a list may take
HURRY_S = 0.25  # shortest time between starting two decoders, however many requests come
MOST_RETURNS = 4  # number of overtaken requests that are remembered
PLAYED_S = 5.0  # a medium that ends after this time does not count as failed


class Opening(NamedTuple):
    """A medium that is being opened during the show.

    loop : whether its reader starts again at its end.
    """

    medium: Medium
    reader: MediaReader
    loop: bool


class _Return(NamedTuple):
    """The state to return to if a request cannot be met.

    media : the list to restore; None keeps the present list.
    position : position in the list.
    waiting : whether the medium at `position` must be opened again.
    """

    media: list[Medium] | None
    position: int
    waiting: bool


class Programme:
    """Decides what plays. The session calls `plays`, `ended`, `broke` and `refused` to report events.

    lasting : whether only a user ends the show.
    begins_again : whether the list or the medium starts again at its end.
    keep : what stays on the screen at the end, as in `keep-open` without "auto".
    looping : whether media start again at their end.
    notice : takes a line for the user.
    clock : seconds, monotonic.

    at_end : whether the end is held, until a user requests a medium or seeks.
    on : position of the playing medium in the list.
    over : whether that medium has ended, or nothing plays.
    done : whether the show has ended.
    failure : the error that ended the show; None for a regular end.
    """

    def __init__(
        self,
        playlist: Playlist,
        opener: Media,
        *,
        lasting: Callable[[], bool],
        begins_again: Callable[[], bool],
        keep: Callable[[], str],
        looping: Callable[[], bool],
        notice: Callable[[str], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.playlist, self.opener, self._notice, self._clock = playlist, opener, notice, clock
        self._lasting, self._looping, self._keep = lasting, looping, keep
        self._begins_again, self.at_end = begins_again, False
        self.over, self.done, self.on = True, False, playlist.position
        self._playing = ""  # name of the medium that has played last
        self.failure: InputError | None = None
        self._opening: Opening | None = None
        self._ahead: Opening | None = None  # the next medium, opened in advance
        # media that failed to open in advance, before that medium
        self._failed_ahead: list[tuple[Medium, InputError]] = []
        self._list: tuple[LookUp[list[Medium]], float] | None = None  # the list that is being read, and its deadline
        self._faults: dict[str, str] = {}  # the last fault of each medium that has not played to its end since
        self._error: InputError | None = None  # why the current medium cannot be opened
        self._returns: list[_Return] = []  # one entry per request; the first entry is what plays
        self._by, self._tries = 1, 0  # direction in which a request skips failing media, and how many it has skipped
        # failed media in a row, failed rounds of the list, position of the first failure
        self._failures = self._rounds = self._first_failed = 0
        self._open_at_s: float | None = None  # clock time at which the current medium is opened
        # when a medium was last opened, and when the present medium began
        self._opened_at_s = self._began_s = float("-inf")
        self._open()

    def poll(self) -> Opening | None:
        """Return a medium whose first frame is ready to replace the present medium, otherwise None.

        The caller must answer with `plays` or `refused`.
        """
        if self._open_at_s is not None and self._clock() >= self._open_at_s:
            self._open()
        while True:  # skips all media that are known to fail
            try:
                return self._ready()
            except InputError as error:
                self.refused(error)

    def _ready(self) -> Opening | None:
        if self._error is not None:
            raise self._error
        if self._list is not None:
            self._unfold(*self._list)
        if self._opening is None or not self._opening.reader.ready():
            return None
        opening, self._opening = self._opening, None
        return opening

    def plays(self) -> None:
        """Record that the session now shows the opened medium."""
        self.at_end, self.over, self.on, self._began_s = False, False, self.playlist.position, self._clock()
        self._returns, self._playing = [], self.playlist.current.name

    def ended(self) -> None:
        """Record that the present medium has ended."""
        self.over = True
        self._faults.pop(self._playing, None)
        if self._is_busy or self.at_end:
            return
        self._failures = self._rounds = 0
        if self._keep() == "always":
            self.at_end = True
        else:
            self._go_on()

    def resume(self) -> None:
        """Record a seek in the medium whose end was held."""
        self.at_end = self.over = False

    @property
    def skipped(self) -> int:
        """Number of media in the list that failed at their last turn and do not play now."""
        playing = "" if self.over else self._playing
        return sum(medium.name in self._faults and medium.name != playing for medium in self.playlist.media)

    @property
    def is_last(self) -> bool:
        """Whether no medium follows the present medium."""
        return not self._is_busy and self.playlist.after(1) is None

    @property
    def next_waits(self) -> bool:
        """Whether the next medium is open and its first frame is ready."""
        return not self._is_busy and self._ahead is not None and self._ahead.reader.ready()

    def look_ahead(self) -> Opening | None:
        """Open the next medium in advance, skipping media that fail. Returns it once its first frame is ready.

        The error of a skipped medium is reported when its turn comes.
        """
        target = None if self._is_busy else self.playlist.after(1 + len(self._failed_ahead))
        if target is None or len(self._failed_ahead) >= len(self.playlist.media):
            return None
        medium = self.playlist.media[target]
        if self._ahead is not None and self._ahead.medium != medium:  # the list has changed since the medium was opened
            self._forget_ahead()
        if self._ahead is None and is_list(medium):
            return None
        try:
            if self._ahead is None:
                self._ahead = self._begin(medium)
            return self._ahead if self._ahead.reader.ready() else None
        except InputError as error:
            if self._ahead is not None:
                self._ahead.reader.close()
            self._ahead = None
            self._failed_ahead.append((medium, error))
            return None

    def broke(self, error: InputError) -> None:
        """Record that the present medium cannot be decoded any further."""
        self.over = True
        if self._clock() - self._began_s >= PLAYED_S:
            self._failures = self._rounds = 0
        if self._is_busy:
            self._notice(str(error))
        else:
            self._pass_over(error)

    def refused(self, error: InputError) -> None:
        """Record that the requested medium cannot be played."""
        self._stop_opening()
        if not self._returns:
            self._pass_over(error)
            return
        self._notice(str(error))
        self._tries += 1
        comes_round = self.playlist.after(self._by) == self._returns[-1].position and self._returns[-1].media is None
        if self._tries < len(self.playlist.media) and not comes_round and self.playlist.step(self._by):
            self._open()
        else:
            self._go_back(self._returns.pop())

    def go(self, by: int) -> bool:
        """Request the next medium (1) or the previous medium (-1). Returns False if there is none."""
        before = self._here()
        if not self.playlist.step(by):
            return False
        self._wish(before, by)
        return True

    def select(self, position: int) -> None:
        """Request the medium at a position of the list."""
        before, self.playlist.position = self._here(), position
        self._wish(before)

    def load(self, name: str, *, replace: bool, follows: bool = False, play: bool = False) -> Medium:
        """Request a medium or a list. Raises InputError if it cannot be played.

        If a replacement turns out to be unplayable later, the old list is restored.

        name : name of the medium or list.
        replace : whether it replaces the whole list.
        follows : whether it is inserted after the present medium, and not at the end.
        play : whether to play it at once if the end is held.
        """
        medium = self.opener.medium(name)
        media = LookUp(partial(self.opener.find, medium)).result(LOOK_S) or [medium]
        before = self._here()._replace(media=self.playlist.media)
        at = self.playlist.position + 1 if follows else len(self.playlist.media)
        self.playlist.add(media, replace=replace, at=at)
        if replace:
            self._wish(before)
            return medium
        self._renumber(lambda old: old + len(media) * (old >= at))
        if play and self.at_end:
            self.select(at)
        elif self._open_at_s is not None:
            self._open_at_s = self._clock()
        return medium

    def remove(self, position: int) -> bool:
        """Remove a medium from the list; for the present medium, open the next one. Returns False without a next one.

        Raises InputError for the only medium.
        """
        media = self.playlist.media
        if len(media) == 1:
            raise InputError(f"{media[0]}: the only medium of the list; load another one, or quit")
        present = position == self.playlist.position
        self._reorder([old for old in range(len(media)) if old != position])
        if not present:
            return True
        follows = position < len(self.playlist.media) or self.playlist.loop
        if follows:
            self.select(position % len(self.playlist.media))
        else:
            self._stop_opening()
        return follows

    def clear(self) -> None:
        """Remove all media but the present medium."""
        self._reorder([self.playlist.position])

    def move(self, position: int, before: int) -> None:
        """Move the medium at `position` to before the medium at `before`."""
        others = [old for old in range(len(self.playlist.media)) if old != position]
        at = before - (before > position)
        self._reorder([*others[:at], position, *others[at:]])

    def shuffle(self) -> None:
        order = list(range(len(self.playlist.media)))
        random.shuffle(order)
        self._reorder(order)

    def _reorder(self, order: Sequence[int]) -> None:
        """Reorder the list.

        order : old positions in their new order; positions that are left out are removed.
        """
        self.playlist.media = [self.playlist.media[old] for old in order]
        places, last = {old: new for new, old in enumerate(order)}, len(order) - 1
        self._renumber(lambda old: places.get(old, min(old, last)))

    def _renumber(self, place: Callable[[int], int]) -> None:
        """Update all stored positions after a change of the list.

        place : maps an old position to the new position.
        """
        self.on, self.playlist.position = place(self.on), place(self.playlist.position)
        self._first_failed = place(self._first_failed)
        kept = (
            each if each.media is not None else each._replace(position=place(each.position)) for each in self._returns
        )
        self._returns = list(kept)
        self._forget_ahead()

    def close(self) -> None:
        self._stop_opening()
        self._forget_ahead()

    @property
    def is_opening(self) -> bool:
        """Whether a medium is being opened."""
        return self._opening is not None

    @property
    def _is_busy(self) -> bool:
        """Whether the next medium has already been chosen."""
        return any(way is not None for way in (self._opening, self._list, self._error, self._open_at_s))

    def _here(self) -> _Return:
        waiting = self.over or self._is_busy
        return _Return(None, self.playlist.position if waiting else self.on, waiting)

    def _wish(self, before: _Return, by: int = 1) -> None:
        """Open the current medium of the list at a user's request. Cancels earlier requests.

        before : state to return to if the request cannot be met.
        by : direction in which failing media are skipped.
        """
        overtakes = self._opening is not None or self._open_at_s is not None
        self._stop_opening()
        self._failures = self._rounds = self._tries = 0
        self._by = by
        self._returns.append(before)
        if len(self._returns) > MOST_RETURNS:
            del self._returns[1]
        self._open_at_s = self._opened_at_s + HURRY_S if overtakes else self._clock()

    def _open(self) -> None:
        """Begin to open the list's current medium. If it is itself a list, read it first."""
        medium, self._open_at_s, self._opened_at_s = self.playlist.current, None, self._clock()
        if self._failed_ahead and self._failed_ahead[0][0] == medium:
            self._error = self._failed_ahead.pop(0)[1]
            return
        try:
            if is_list(medium):
                self._list = LookUp(partial(self.opener.find, medium)), self._clock() + LIST_S
            elif self._ahead is not None and (self._ahead.medium, self._ahead.loop) == (medium, self._looping()):
                self._opening, self._ahead = self._ahead, None
            else:
                self._opening = self._begin(medium)
        except InputError as error:
            self._error = error
        self._forget_ahead()

    def _begin(self, medium: Medium) -> Opening:
        loop = self._looping()
        return Opening(medium, self.opener.begin(medium, loop=loop), loop)

    def _forget_ahead(self) -> None:
        if self._ahead is not None:
            self._ahead.reader.close()
        self._ahead, self._failed_ahead = None, []

    def _unfold(self, look: LookUp[list[Medium]], until_s: float) -> None:
        found = look.result()
        if found is None and self._clock() > until_s:
            raise InputError(f"{self.playlist.current}: not read within {LIST_S:g} s; copy it to a local disk")
        if found is not None:
            self.playlist.unfold(found)
            if self.playlist.position < self.on:
                self.on += len(found) - 1
            self._list = None
            self._open()

    def _stop_opening(self) -> None:
        if self._opening is not None:
            self._opening.reader.close()
        self._opening = self._list = self._error = self._open_at_s = None

    def _go_on(self) -> None:
        if self.playlist.step(1):
            self._open()
        elif self._keep() == "no":
            self.done = True
        else:
            self.at_end = True

    def _go_back(self, before: _Return) -> None:
        """Restore the list and the position after a request that could not be met."""
        self._tries = 0
        self.playlist.media = self.playlist.media if before.media is None else before.media
        self.playlist.position = before.position
        if before.waiting:
            self._open()
        elif self.over:
            self._go_on()

    def _pass_over(self, error: InputError) -> None:
        """Skip a medium that failed. If no medium plays, a lasting show tries again later, and other shows end."""
        if not self._failures:
            self._first_failed = self.playlist.position
        self._failures += 1
        name = self.playlist.current.name
        fresh = self._faults.get(name) != str(error)
        self._faults[name] = str(error)
        if self._failures < len(self.playlist.media) and self.playlist.step(1):
            if fresh:
                self._notice(str(error))
            self._open()
        elif self._began_s > float("-inf") and not self._begins_again():
            if self._keep() == "no" and not self._lasting():
                self.failure = error
            else:
                self._notice(str(error))
            self._go_on()
        elif self._lasting():
            wait_s = retry_s(self._rounds)
            if fresh:
                self._notice(f"{error}; trying again after 1, 2, 4 … {LONGEST_RETRY_S:g} s")
            self._failures, self._rounds = 0, self._rounds + 1
            self.playlist.position, self._open_at_s = self._first_failed, self._clock() + wait_s
        else:
            self.failure, self.done = error, True

"""Checks the room between media, and loads the correction that a check has found."""

from counterlight.errors import InputError
from counterlight.show.registry import CommandError, Commands
from counterlight.show.session import Session
from counterlight.unattended.room_checks import Outcome, RoomChecks


class CheckedRoom:
    """Runs checks of the room: between two media or, if the list has one medium, whenever a check is due.

    The medium pauses during a check, because the check's pictures cover it.
    """

    def __init__(self, session: Session, commands: Commands, checks: RoomChecks) -> None:
        self._session, self._commands, self._checks = session, commands, checks
        self._playing, self._paused = session.playback, False
        self._asked = False

    @property
    def running(self) -> bool:
        return self._checks.running

    def ask(self) -> str:
        """Request a check now, whether or not a check is due."""
        if self._checks.running or self._asked:
            raise CommandError("check-room: a check is running")
        self._asked = True
        return "checking the room"

    def poll(self) -> None:
        """Begin a check that is due, and end a check that has finished."""
        session, checks = self._session, self._checks
        between = session.playback is not self._playing or len(session.playlist.media) < 2
        self._playing = session.playback
        if checks.running:
            outcome = checks.outcome()
            if outcome is not None:
                self._take(outcome)
        elif self._asked or (checks.due and between and session.playback is not None):
            self._begin()

    def close(self) -> None:
        self._checks.close()

    def _begin(self) -> None:
        session = self._session
        try:
            self._checks.begin()
        except OSError as error:
            session.notice(f"the room's check: {error}")
            self._asked = False
            return
        self._paused, session.manner.paused = session.manner.paused, True

    def _take(self, outcome: Outcome) -> None:
        session, asked = self._session, self._asked
        self._asked = False
        if session.manner.paused:  # if not paused, the user has resumed playback
            session.manner.paused = self._paused
        if outcome.code:
            session.notice(f"the room's check: {outcome.said}")
            return
        try:
            if session.room.drifts:
                self._commands.run("reload")
            elif not asked:
                return
            session.stats.notice(outcome.said)
        except (CommandError, InputError, OSError) as error:
            session.notice(str(error))

"""Starts the functions that run besides a show: checks of the room, the watcher, projectors, other machines."""

import argparse
import os
import sys
import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from counterlight.errors import InputError
from counterlight.jobs.workers import THREADS
from counterlight.pipeline.shown_copies import factor_of
from counterlight.show.from_options import cameras_of, check_of
from counterlight.show.in_step import Curtain, Follower, Leader
from counterlight.show.schedule_file import read_schedule
from counterlight.show.session import Session
from counterlight.show.watching import Watching
from counterlight.unattended.cues import Beacon, Listener
from counterlight.unattended.pjlink import Lamps
from counterlight.unattended.room_checks import RoomChecks
from counterlight.unattended.watch_link import Start
from counterlight.unattended.watcher import Watcher


def checks_of(options: argparse.Namespace) -> RoomChecks | None:
    """Return the checks of the room by counterlight verify, None if the options request none."""
    found = check_of(options)
    if found is None:
        return None
    words, every_s = found
    verify = sys.executable, "-P", "-m", "counterlight", "verify", str(options.calibration), *words
    return RoomChecks(verify, every_s)


def watching_of(
    options: argparse.Namespace, session: Session, refresh_s: Callable[[], float], stack: ExitStack
) -> Watching | None:
    """Return the calibration from the running film, None without --watch. The stack removes the watcher's files.

    refresh_s : period of the display.

    Raises InputError for a room of several views, which see the picture from different places.
    """
    cameras, room = cameras_of(options), session.room.read_last
    if not cameras:
        if options.watch_record is not None:
            raise InputError("--watch-record keeps what a camera sees; name the camera with --watch")
        return None
    if room.others:
        raise InputError("--watch: the room has several views; watch a room of one view, or leave it out")
    folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="counterlight-watch-"))
    start = Start(
        str(options.calibration),
        tuple(cameras),
        options.exposures or (),
        factor_of(min(region.width for region in room.calibration.regions)),
        refresh_s(),
        folder,
        room.maps.mixing.tier,
        _made(options.watch_record),
    )
    command = sys.executable, "-P", "-m", "counterlight.tools.watching"
    one_thread = os.environ | dict.fromkeys(THREADS, "1")  # the show needs the other cores
    watching = Watching(
        session, Watcher(command, session.notice, environment=one_thread), start, dims=options.white == "auto"
    )
    watching.freeze(options.watch_freeze)
    return watching


def _made(folder: Path | None) -> str:
    """Make the folder of --watch-record; returns its name, empty for none."""
    if folder is None:
        return ""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--watch-record {folder}: cannot be made ({error.strerror}); check path and rights") from None
    return str(folder)


def lamps_of(options: argparse.Namespace, stack: ExitStack) -> Lamps | None:
    """Return the projectors of the schedule, None without a schedule. The stack closes them."""
    if options.schedule is None:
        return None
    try:
        lamps = Lamps(read_schedule(options.schedule).projectors)
    except InputError:  # damaged since the start; the supervisor has reported the damage
        return None
    stack.callback(lamps.close)
    return lamps


def in_step_of(options: argparse.Namespace, session: Session, stack: ExitStack) -> list[Callable[[], None]]:
    """Return the poll functions that synchronise this show with other machines. The stack closes their sockets."""
    polled: list[Callable[[], None]] = []
    if options.lead is not None:
        beacon = Beacon(options.lead)
        stack.callback(beacon.close)
        polled.append(Leader(session, beacon).poll)
    if options.follow is not None:
        listener = Listener(options.follow)
        stack.callback(listener.close)
        polled.append(Follower(session, listener).poll)
    if options.at is not None:
        polled.append(Curtain(session, options.at).poll)
    return polled

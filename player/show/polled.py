"""Starts what the options ask to run next to a show: checks of the room, projector power, synchronised machines."""

import argparse
import sys
from collections.abc import Callable
from contextlib import ExitStack

from counterlight.errors import InputError
from counterlight.show.from_options import check_of
from counterlight.show.in_step import Curtain, Follower, Leader
from counterlight.show.schedule_file import read_schedule
from counterlight.show.session import Session
from counterlight.unattended.cues import Beacon, Listener
from counterlight.unattended.pjlink import Lamps
from counterlight.unattended.room_checks import RoomChecks


def checks_of(options: argparse.Namespace) -> RoomChecks | None:
    """Return the checks of the room by counterlight verify, None if the options ask for none."""
    told = check_of(options)
    if told is None:
        return None
    words, every_s = told
    verify = sys.executable, "-P", "-m", "counterlight", "verify", str(options.calibration), *words
    return RoomChecks(verify, every_s)


def lamps_of(options: argparse.Namespace, stack: ExitStack) -> Lamps | None:
    """Return the projectors of the schedule, None without a schedule. The stack closes them."""
    if options.schedule is None:
        return None
    try:
        lamps = Lamps(read_schedule(options.schedule).projectors)
    except InputError:  # damaged since the supervisor started, which has reported it
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

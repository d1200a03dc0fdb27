"""counterlight play: show media through the correction map of a calibrated room."""

import argparse
import os
import socket
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

from counterlight.calibration import check_order, read_projectors
from counterlight.command import command_line, conclusion, tell, verb
from counterlight.errors import InputError
from counterlight.pipeline.adjustments import Adjustments
from counterlight.pipeline.placement import read_placement
from counterlight.pipeline.room import Room
from counterlight.show.command_line import read_options
from counterlight.show.control import ControlServer, Remote
from counterlight.show.from_options import adjustments_of, check_of, monitors_of, names_of_monitors, room_of
from counterlight.show.in_window import play_in_window
from counterlight.show.options import OPTIONS, WITHOUT_COMPENSATION
from counterlight.show.playlist import files_of
from counterlight.show.remotes import open_remotes
from counterlight.show.schedule_file import ScheduleFile
from counterlight.unattended.heartbeat import Heartbeat, Notifier
from counterlight.unattended.supervisor import supervise
from counterlight.unattended.waiting import wait_for
from counterlight.writing.outputs import check_apart, check_file, check_log


@verb
def main(argv: Sequence[str] | None) -> int | None:
    options = read_options(argv, __doc__ or "")
    if options.supervise:
        if options.output is not None:
            raise InputError("--supervise keeps a window running; leave out --output")
        arguments = sys.argv[1:] if argv is None else argv
        schedule = None if options.schedule is None else ScheduleFile(options.schedule)
        return supervise(
            arguments,
            safe=options.safe,
            monitors=_monitors_of_room(options),
            fullscreen=options.fullscreen,
            plain_options=WITHOUT_COMPENSATION,
            notify_socket=os.environ.get("NOTIFY_SOCKET"),
            schedule=schedule,
        )
    if options.schedule is not None and not options.supervised and options.output is None:
        raise InputError("--schedule is kept by the supervisor; add --supervise")
    _show(options)
    return None


def _show(options: argparse.Namespace) -> None:
    if options.list_monitors:
        from counterlight.gl.monitors import list_monitors

        print("\n".join(str(monitor) for monitor in list_monitors()))
        return
    if options.calibration is None or not options.media:
        raise InputError(_missing(options.calibration))
    check_order(options.calibration, [medium.name for medium in options.media])
    check_of(options)
    _check_outputs(options)
    adjustments = adjustments_of(options)

    def placed() -> Adjustments:
        return replace(adjustments, corners=read_placement(options.calibration))

    if options.output:
        from counterlight.show.into_file import render

        stats = render(options, lambda: _reported_room(options), placed())
    else:
        _check_window(options)
        with _attached(options) as (remotes, heartbeat, farewell):
            stats = play_in_window(
                options,
                wait_for(lambda: _reported_room(options), heartbeat if options.supervised else None),
                placed(),
                remotes=remotes,
                heartbeat=heartbeat,
                farewell=farewell,
            )
        action = command_line("verify", options.calibration, "--camera", "CAMERA")
        tell(conclusion(f"{options.calibration}: played {stats.frames} frames", action), sys.stdout)
    if options.stats is not None:
        stats.write(options.stats)


def _missing(only: Path | None) -> str:
    """Return the error for a command line without a room or a medium.

    only : the only argument; None without arguments.
    """
    if only is None:
        return f"a room and a medium are missing; for example: {command_line('play', 'room', 'film.mp4')}"
    if only.is_file():
        return f"the room of {only} is missing; for example: {command_line('play', 'room', only)}"
    return f"the medium for {only} is missing; for example: {command_line('play', only, 'film.mp4')}"


def _check_outputs(options: argparse.Namespace) -> None:
    """Raise InputError, before anything is read, for outputs that are unwritable or would overwrite an input."""
    heartbeat = None if options.heartbeat in (None, "-") else Path(options.heartbeat)
    check_apart(options.output, options.stats, heartbeat, options.control)
    if options.output is options.stats is heartbeat is None:
        return
    inputs = [path for medium in (*options.lists, *options.media) for path in files_of(medium)]
    inputs += [] if options.lut is None else [options.lut]
    if options.output is not None:
        from counterlight.show.into_file import coding_of  # imports PyAV, which a window does not need
        from counterlight.show.output import check_output

        check_output(options.output, inputs=inputs, coding=coding_of(options))
    if options.stats is not None:
        check_file(options.stats, inputs=inputs)
    if heartbeat is not None:
        check_log(heartbeat, inputs=inputs)


def _reported_room(options: argparse.Namespace) -> Room:
    room = room_of(options)
    if room.maps.mixing.neutral is not None:
        tell(f"colour: {room.maps.mixing.tier}, as the maps were built", sys.stdout)
    outside = room.outside(options.viewpoint)
    if outside is not None:
        tell(outside)
    tell(f"white is a camera radiance of {room.white:.4g}{' (auto)' if options.white == 'auto' else ''}", sys.stdout)
    if options.view == "error" and room.expected:
        tell(f"what the view error leaves out: {room.expected}", sys.stdout)
    return room


@contextmanager
def _attached(options: argparse.Namespace) -> Iterator[tuple[list[Remote], Heartbeat, Callable[[], None]]]:
    """Yield the remotes, the heartbeat, and a function that tells both that the show has ended."""
    with ExitStack() as stack:
        heartbeat = Heartbeat(options.heartbeat, Notifier(os.environ.get("NOTIFY_SOCKET")))
        stack.callback(heartbeat.close)
        remotes: list[Remote] = []
        if options.control is not None:
            remotes.append(ControlServer(options.control))
            stack.callback(remotes[-1].close)
        if options.remote is not None or options.osc is not None:
            remotes.append(open_remotes(options.remote, options.osc))
            stack.callback(remotes[-1].close)
        yield remotes, heartbeat, stack.close


def _check_window(options: argparse.Namespace) -> None:
    for name, row in OPTIONS.items():
        if row.needs == "output" and name in options.given:
            value = getattr(options, name.replace("-", "_"))
            raise InputError(f"--{name} {value}: is for --output; leave it out, or add --output FILE")
    if options.follow is not None and not options.supervised:
        try:
            socket.getaddrinfo(*options.follow)
        except OSError as error:
            raise InputError(f"--follow {options.follow[0]}: {error.strerror}; check the leader's name") from None
    if not options.screenshot_directory.is_dir():
        raise InputError(f"{options.screenshot_directory}: no such folder for --screenshot-directory; make it first")


def _monitors_of_room(options: argparse.Namespace) -> list[str]:
    """Return the monitors without reading the whole room. If the room cannot be read, return the named monitors."""
    try:
        return names_of_monitors(options, () if options.calibration is None else read_projectors(options.calibration))
    except InputError:
        return monitors_of(options)


if __name__ == "__main__":
    sys.exit(main())

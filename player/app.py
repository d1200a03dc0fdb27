"""counterlight play: show media through the correction map of a calibrated room."""

import argparse
import os
import socket
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from counterlight.calibration import Device, check_order, read_projectors
from counterlight.command import run, tell
from counterlight.errors import InputError
from counterlight.media.audio import open_audio
from counterlight.pipeline.adjustments import Adjustments
from counterlight.pipeline.placement import read_placement
from counterlight.pipeline.renderer import AnyRenderer
from counterlight.pipeline.room import Room
from counterlight.show.command_line import read_options
from counterlight.show.compiling import compile_passes
from counterlight.show.control import ControlServer, Remote
from counterlight.show.from_options import (
    adjustments_of,
    backend_of,
    check_of,
    governor_of,
    monitors_of,
    path_of,
    playing_of,
    room_of,
)
from counterlight.show.media import Media
from counterlight.show.options import OPTIONS, WITHOUT_COMPENSATION
from counterlight.show.playlist import Playlist, files_of
from counterlight.show.polled import checks_of, in_step_of, lamps_of, watching_of
from counterlight.show.remotes import open_remotes
from counterlight.show.room_in_use import RoomInUse
from counterlight.show.schedule_file import ScheduleFile
from counterlight.show.session import NO_SOUND, Session, Showing, Sound
from counterlight.show.show import Show
from counterlight.show.stats import Stats
from counterlight.unattended.heartbeat import Heartbeat, Notifier
from counterlight.unattended.supervisor import supervise
from counterlight.writing.outputs import check_apart, check_file, check_log

if TYPE_CHECKING:
    from counterlight.gl.displays import Displays
    from counterlight.gl.window import Window


def main(argv: Sequence[str] | None = None) -> int:
    return run(_main, argv)


def _main(argv: Sequence[str] | None) -> int | None:
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
        raise InputError("counterlight play: needs a CALIBRATION and MEDIA; see counterlight play --help")
    check_order(options.calibration, [medium.name for medium in options.media])
    check_of(options)
    _check_outputs(options)
    adjustments = replace(adjustments_of(options), corners=read_placement(options.calibration))
    if options.output:
        from counterlight.show.into_file import render

        stats = render(options, lambda: _room_told(options), adjustments)
    else:
        _check_window(options)
        with _attached(options) as (remotes, heartbeat, farewell):
            stats = play_in_window(
                options, _room_told(options), adjustments, remotes=remotes, heartbeat=heartbeat, farewell=farewell
            )
    if options.stats is not None:
        stats.write(options.stats)


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


def _room_told(options: argparse.Namespace) -> Room:
    room = room_of(options)
    if room.maps.mixing.neutral is not None:
        tell(f"colour: {room.maps.mixing.tier}, as the maps were built", sys.stdout)
    outside = room.outside(options.viewpoint)
    if outside is not None:
        tell(outside)
    tell(f"white is a camera radiance of {room.white:.4g}{' (auto)' if options.white == 'auto' else ''}", sys.stdout)
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


def play_in_window(
    options: argparse.Namespace,
    room: Room,
    adjustments: Adjustments,
    *,
    remotes: Sequence[Remote] = (),
    heartbeat: Heartbeat | None = None,
    farewell: Callable[[], None] = lambda: None,
) -> Stats:
    """Play in a window until the show ends.

    remotes : may command the session.
    heartbeat : receives the facts of the show.
    farewell : called if the screen is lost, which ends the process.
    """
    from counterlight.gl import lost_screen
    from counterlight.gl.monitors import refresh_s
    from counterlight.gl.renderer import WindowRenderer

    with ExitStack() as stack:
        window = stack.enter_context(_display(options, room))
        stack.enter_context(lost_screen.farewell(farewell))
        session = _session(options, room, adjustments, window, stack, commanded=bool(remotes))
        del room  # a reload must be able to free it

        def shown() -> Any:
            assert isinstance(session.renderer, WindowRenderer)
            return session.renderer.encoded_texture

        window.attach(shown, lambda: session.rendered_view == "projector")
        show = Show(
            session,
            bindings=options.keys,
            remotes=remotes,
            heartbeat=heartbeat,
            checks=checks_of(options),
            watching=watching_of(options, session, lambda: refresh_s(window.monitor), stack),
            polled=in_step_of(options, session, stack),
            lamps=lamps_of(options, stack),
            on_interrupt=lambda stats: None if options.stats is None else stats.write(options.stats),
        )
        return show.run(options.frames)


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


def _monitors(options: argparse.Namespace, projectors: Sequence[Device]) -> list[str]:
    """Return the name or number of each projector's monitor."""
    names = [projector.monitor or str(number) for number, projector in enumerate(projectors)]
    return monitors_of(options) or names


def _monitors_of_room(options: argparse.Namespace) -> list[str]:
    """Return the monitors without reading the whole room. If the room cannot be read, return the named monitors."""
    try:
        return _monitors(options, () if options.calibration is None else read_projectors(options.calibration))
    except InputError:
        return monitors_of(options)


def _display(options: argparse.Namespace, room: Room) -> AbstractContextManager["Window | Displays"]:
    """Open a window per projector."""
    from counterlight.gl.displays import open_display

    return open_display(
        room.calibration.regions,
        "Counterlight",
        monitors=_monitors(options, room.calibration.projectors),
        there=bool(monitors_of(options)),
        fullscreen=options.fullscreen,
        exact=not options.any_size,
        vsync=options.vsync,
        bits=None if options.bits == "auto" else int(options.bits),
    )


def _renderer_for(options: argparse.Namespace, window: "Window | Displays") -> "Callable[[Room], AnyRenderer]":
    """Return the factory of renderers: OpenGL on a GPU, on request, or for 10-bit codes; otherwise the processor."""
    from counterlight.gl.context import in_software

    chosen = backend_of(options)
    if chosen == "auto":
        drawn = window.bits > 8 or not in_software(window.context.info["GL_RENDERER"])
        chosen = "gl" if drawn else "cpu"
    if chosen == "cpu":
        with _without_blas():
            compile_passes()
        from counterlight.gl.computed import ComputedRenderer

        return partial(ComputedRenderer, window.context)
    from counterlight.gl.renderer import GlRenderer

    return lambda room: GlRenderer(window.context, room, path_of(options), window.bits)


@contextmanager
def _without_blas() -> Iterator[None]:
    """Keep Numba from importing scipy.linalg for a BLAS, which no pass needs: a seventh of the startup."""
    absent = {name: None for name in ("scipy.linalg", "scipy.linalg.cython_blas") if name not in sys.modules}
    sys.modules.update(absent)  # type: ignore[arg-type]
    try:
        yield
    finally:
        for name in absent:
            del sys.modules[name]


def _session(
    options: argparse.Namespace,
    room: Room,
    adjustments: Adjustments,
    window: "Window | Displays",
    stack: ExitStack,
    *,
    commanded: bool,
) -> Session:
    """Return a session in the window. The stack closes the sound device.

    commanded : whether a remote may continue the show.
    """
    made = _renderer_for(options, window)
    sound = Sound(*open_audio(options.volume, mute=options.mute)) if options.audio else NO_SOUND
    if sound.output is not None:
        stack.callback(sound.output.close)

    def renewed(fresh: Room) -> AnyRenderer:
        """Return a renderer of the reloaded room. The window reloads its shader if everything is intact."""
        renderer = made(fresh)
        try:
            window.reload()
        except BaseException:
            renderer.release()
            raise
        return renderer

    return Session(
        Playlist(options.media, loop=options.loop and len(options.media) > 1, start=options.playlist_start),
        Media(options.border, options.fps, options.hwdec),
        made(room),
        window,
        RoomInUse(options.calibration, room, lambda: room_of(options), renewed),
        governor=governor_of(options, room, room.default_steps),
        playing=playing_of(options),
        showing=Showing(options.view, options.compensation, adjustments, options.blackout, options.osd),
        sound=sound,
        appraised=options.stats is not None,
        lasting=options.lasting or commanded,
        unattended=options.supervised,
        screenshots=options.screenshot_directory,
    )


if __name__ == "__main__":
    sys.exit(main())

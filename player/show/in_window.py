"""Plays in a window: opens a display and a sound device, makes the session, and runs the show."""

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any

from counterlight.calibration import Device
from counterlight.media.audio import open_audio
from counterlight.pipeline.adjustments import Adjustments
from counterlight.pipeline.renderer import AnyRenderer
from counterlight.pipeline.room import Room
from counterlight.raster import Region
from counterlight.show.beginning import NO_SOUND, Showing, Sound
from counterlight.show.compiling import compile_passes
from counterlight.show.control import Remote
from counterlight.show.from_options import (
    backend_of,
    governor_of,
    monitors_of,
    names_of_monitors,
    path_of,
    playing_of,
    room_of,
)
from counterlight.show.media import Media
from counterlight.show.playlist import Playlist
from counterlight.show.polled import checks_of, in_step_of, lamps_of, watching_of
from counterlight.show.room_in_use import RoomInUse
from counterlight.show.session import Session
from counterlight.show.show import Show
from counterlight.show.stats import Stats
from counterlight.unattended.heartbeat import Heartbeat
from counterlight.unattended.waiting import wait_for

if TYPE_CHECKING:
    from counterlight.gl.displays import Displays
    from counterlight.gl.window import Window


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
    from counterlight.gl import x11
    from counterlight.gl.monitors import refresh_s
    from counterlight.gl.renderer import WindowRenderer

    with ExitStack() as stack:
        display = partial(_display, options, room.calibration.regions, room.calibration.projectors)
        window = wait_for(lambda: stack.enter_context(display()), heartbeat if options.supervised else None)
        stack.enter_context(x11.farewell(farewell))
        session = _session(options, room, adjustments, window, stack, commanded=bool(remotes))
        del room  # a reference here would keep the room in memory after a reload

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


def _display(
    options: argparse.Namespace, regions: Sequence[Region], projectors: Sequence[Device]
) -> AbstractContextManager["Window | Displays"]:
    """Open a window per projector."""
    from counterlight.gl.displays import open_display

    return open_display(
        regions,
        "Counterlight",
        monitors=names_of_monitors(options, projectors),
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
        from counterlight.gl.renderer import ComputedRenderer

        return partial(ComputedRenderer, window.context)
    from counterlight.gl.renderer import GlRenderer

    return lambda room: GlRenderer(window.context, room, path_of(options), window.bits)


@contextmanager
def _without_blas() -> Iterator[None]:
    """Keep Numba from importing scipy.linalg, which no pass needs; the import takes a seventh of the startup."""
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

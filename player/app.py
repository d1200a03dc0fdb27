"""counterlight play: show media through the correction map of a calibrated room."""

import argparse
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from counterlight.calibration import check_order
from counterlight.command import run, tell
from counterlight.errors import InputError
from counterlight.jobs.workers import Processes, Workers
from counterlight.media.audio import open_audio
from counterlight.media.video import MediaReader
from counterlight.pipeline.adjustments import Adjustments
from counterlight.pipeline.placement import read_placement
from counterlight.pipeline.refinement import STEPS_OF_A_STILL
from counterlight.pipeline.renderer import Renderer
from counterlight.pipeline.room import Room, read_room
from counterlight.show.beside import checks_of, in_step_of, lamps_of
from counterlight.show.control import ControlServer, Remote
from counterlight.show.governor import Governor
from counterlight.show.headless import chosen_backend, headless_renderer, render_to_file
from counterlight.show.media import Media
from counterlight.show.options import (
    adjustments_of,
    check_of,
    ignored,
    image_display_duration,
    monitors_of,
    one_medium,
    read_options,
)
from counterlight.show.output import check_output, is_film
from counterlight.show.playlist import Playlist, files_of
from counterlight.show.remotes import open_remotes
from counterlight.show.rendering import Rendering, Stretch
from counterlight.show.room_in_use import RoomInUse
from counterlight.show.schedule_file import ScheduleFile
from counterlight.show.segmented import render_in_segments, tables_of
from counterlight.show.session import Session
from counterlight.show.show import Show
from counterlight.show.stats import Stats
from counterlight.unattended.heartbeat import Heartbeat, Notifier
from counterlight.unattended.supervisor import supervise
from counterlight.writing.outputs import check_apart, check_file, check_log

SEGMENTS_A_WORKER = 2  # so that one that is slower, or dies, is waited for less


def main(argv: Sequence[str] | None = None) -> int:
    return run(_main, argv)


def _main(argv: Sequence[str] | None) -> int | None:
    options = read_options(argv, __doc__ or "")
    if options.supervise:
        if options.output is not None:
            raise InputError("--supervise keeps a window running; leave out --output")
        arguments = sys.argv[1:] if argv is None else argv
        schedule = None if options.schedule is None else ScheduleFile(options.schedule)
        notify = os.environ.get("NOTIFY_SOCKET")
        monitors = monitors_of(options)
        return supervise(arguments, safe=options.safe, monitors=monitors, notify_socket=notify, schedule=schedule)
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
        stats = _render(options, _room_told(options), adjustments)
    else:
        with _attached(options) as (remotes, heartbeat, farewell):
            stats = play_in_window(
                options, _room_told(options), adjustments, remotes=remotes, heartbeat=heartbeat, farewell=farewell
            )
    if options.stats is not None:
        stats.write(options.stats)


def _check_outputs(options: argparse.Namespace) -> None:
    """InputError, before anything is read or shown, for outputs that cannot be written or would overwrite an input."""
    heartbeat = None if options.heartbeat in (None, "-") else Path(options.heartbeat)
    check_apart(options.output, options.stats, heartbeat, options.control)
    if options.output is options.stats is heartbeat is None:
        return
    inputs = [path for medium in (*options.lists, *options.media) for path in files_of(medium)]
    inputs += [] if options.lut is None else [options.lut]
    if options.output is not None:
        check_output(options.output, inputs=inputs)
    if options.stats is not None:
        check_file(options.stats, inputs=inputs)
    if heartbeat is not None:
        check_log(heartbeat, inputs=inputs)


def _room_told(options: argparse.Namespace) -> Room:
    room = room_of(options)
    if room.maps.mixing.neutral is not None:
        tell(f"colour: {room.maps.mixing.tier}, as the maps were built", sys.stdout)
    outside = room.outside(options.viewpoint)
    for line in [] if outside is None else [outside]:
        tell(line)
    tell(f"white is a camera radiance of {room.white:.4g}{' (auto)' if options.white == 'auto' else ''}", sys.stdout)
    return room


@contextmanager
def _attached(options: argparse.Namespace) -> Iterator[tuple[list[Remote], Heartbeat, Callable[[], None]]]:
    """Who commands the show from elsewhere, who is told how it goes, and what tells both that it is over."""
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


def room_of(options: argparse.Namespace) -> Room:
    white = None if options.white == "auto" else options.white
    path = options.path or ("auto" if options.output is None else "fragment")
    words = path in ("auto", "words", "compute-words")
    limited = options.budget != "no" or options.within != "no"
    if limited and options.refine not in (None, "auto"):
        raise InputError(
            f"--refine {options.refine}: --budget and --within choose the steps themselves; leave one of them out"
        )
    refine = "auto" if limited else options.refine
    return read_room(options.calibration, white, options.dither, refine, options.refine_from, words=words)


def _steps_into_file(options: argparse.Namespace, room: Room, *, still: bool) -> int:
    """A still picture in a file has time for more than a frame of film in a window, if nobody says what is enough."""
    return STEPS_OF_A_STILL if still and room.default_steps and options.within == "no" else room.default_steps


def _governor(options: argparse.Namespace, room: Room, usual: int) -> Governor:
    """usual : steps if nobody says how many.  A start that was given stays."""
    offers = room.offers if options.refine_from is None else ()
    told = {"budget": options.budget, "within": options.within, "start": room.start, "offers": offers}
    return Governor(usual, options.refine, **told)


def _render(options: argparse.Namespace, room: Room, adjustments: Adjustments) -> Stats:
    medium = one_medium(options)
    with MediaReader.open(medium, loop=options.loop, frames_per_second=options.fps) as reader:
        if options.start:
            reader.seek(options.start)
        stats = _render_medium(options, reader, room, adjustments)
        for notice in reader.notices():
            tell(notice)
            stats.notice(notice)
    return stats


def _render_medium(options: argparse.Namespace, reader: MediaReader, room: Room, adjustments: Adjustments) -> Stats:
    if options.loop and options.frames is None:
        raise InputError("--loop with --output never ends; add --frames N")
    if reader.info.live and options.frames is None:
        raise InputError(f"{reader.info.path}: a live source never ends; add --frames N to --output")
    for line in ignored(options, reader.info):
        tell(line)
    if options.refine == "auto" and options.budget == options.within == "no":
        raise InputError(
            "--refine auto is for a window: a file has no time to keep; give a number of steps, --budget or --within"
        )
    if options.lead_in is not None and options.segments is options.cluster is None:
        raise InputError(f"--lead-in {options.lead_in}: is for segments; add --segments N")
    if options.backend == "cpu" and options.path is not None:
        raise InputError(f"--path {options.path}: --backend cpu has no GPU to take it on; leave one of them out")
    backend = "gl" if options.path is not None and options.backend == "auto" else options.backend
    if (options.segments or options.cluster) and is_film(options.output) and not reader.info.still:
        stats = _render_segments(options, reader, room, adjustments, chosen_backend(backend))
    else:
        stats = _render_whole(options, reader, room, adjustments, backend)
    if room.drifted is not None:
        stats.facts["drift"] = room.drifted
    quality = stats.facts.get("camera_psnr_db")
    print(f"{options.output}: {stats.frames} frames" + (f", camera PSNR {quality:.1f} dB" if quality else ""))
    return stats


def _render_whole(
    options: argparse.Namespace, reader: MediaReader, room: Room, adjustments: Adjustments, backend: str
) -> Stats:
    with headless_renderer(backend, room, options.path or "fragment") as renderer:
        renderer.open(reader.info.format)
        renderer.adjust(adjustments)
        return render_to_file(
            reader,
            renderer,
            room.seen_from(adjustments.viewpoint),
            options.output,
            options.view,
            compensate=options.compensation,
            stretch=Stretch(end=options.frames),
            governor=_governor(options, room, _steps_into_file(options, room, still=reader.info.still)),
            appraised=options.stats is not None,
        )


def _render_segments(
    options: argparse.Namespace, reader: MediaReader, room: Room, adjustments: Adjustments, backend: str
) -> Stats:
    if options.budget != "no" or options.within != "no":
        raise InputError("--segments: --budget and --within carry steps from frame to frame; give --refine N instead")
    if reader.info.live:
        raise InputError(f"{reader.info.path}: a live source has no segments; leave out --segments")
    rendering = Rendering(
        calibration=options.calibration.absolute(),
        white=room.white,
        dither=options.dither,
        steps=room.default_steps if options.refine is None else options.refine,
        start=room.start,
        medium=replace(reader.medium, name=os.path.abspath(reader.medium.name)),
        loop=options.loop,
        frames_per_second=options.fps,
        start_s=options.start,
        frames=options.frames,
        backend=backend,
        path=options.path or "fragment",
        view=options.view,
        compensate=options.compensation,
        adjustments=adjustments,
    )
    with _segment_workers(options, reader) as workers:
        count = options.segments or SEGMENTS_A_WORKER * workers.count
        stats = render_in_segments(rendering, reader, options.output, workers, count, options.lead_in)
    for joint in stats.facts["segments"]["within_shots"]:
        frame, differing, of, most = joint.values()
        print(f"divided within a shot at frame {frame}: {differing} of {of} codes differ there, by at most {most:g}")
    return stats


def _segment_workers(options: argparse.Namespace, reader: MediaReader) -> Workers:
    if options.cluster is None:
        return Processes(min(options.segments, os.cpu_count() or 1))
    from counterlight.jobs.cluster import open_cluster

    medium = [] if reader.medium.is_sequence else [Path(reader.medium.name)]
    return open_cluster(options.cluster, [*tables_of(options.calibration), *medium], options.output.absolute().parent)


def play_in_window(
    options: argparse.Namespace,
    room: Room,
    adjustments: Adjustments,
    *,
    remotes: Sequence[Remote] = (),
    heartbeat: Heartbeat | None = None,
    farewell: Callable[[], None] = lambda: None,
) -> Stats:
    """Play in a window until it ends; remotes may command the session, the heartbeat is told how it goes.

    farewell : what is done if the screen goes, which ends the process.
    """
    if options.backend == "cpu":
        raise InputError("--backend cpu has no window; add --output FILE")
    for name, value in (("--segments", options.segments), ("--cluster", options.cluster)):
        if value is not None:
            raise InputError(f"{name} {value}: is for --output; leave it out, or add --output FILE")
    if not options.screenshot_directory.is_dir():
        raise InputError(f"{options.screenshot_directory}: no such folder for --screenshot-directory; make it first")
    from counterlight.gl import lost_screen
    from counterlight.gl.displays import open_display
    from counterlight.gl.renderer import GlRenderer

    named, projectors = monitors_of(options), room.calibration.projectors
    path = options.path or "auto"
    with ExitStack() as stack:
        display = open_display(
            room.calibration.regions,
            "Counterlight",
            monitors=named or [projector.monitor or str(number) for number, projector in enumerate(projectors)],
            there=bool(named),
            fullscreen=options.fullscreen,
            exact=not options.any_size,
            vsync=options.vsync,
            bits=None if options.bits == "auto" else int(options.bits),
        )
        window = stack.enter_context(display)
        stack.enter_context(lost_screen.farewell(farewell))
        audio, silence = open_audio(options.volume, mute=options.mute) if options.audio else (None, None)
        if audio is not None:
            stack.callback(audio.close)

        def renewed(fresh: Room) -> Renderer:
            """A renderer of the room as it is now; the window takes its shader anew if nothing is damaged."""
            renderer = GlRenderer(window.context, fresh, path, window.bits)
            try:
                window.reload()
            except BaseException:
                renderer.release()
                raise
            return renderer

        session = Session(
            Playlist(options.media, loop=options.loop and len(options.media) > 1, start=options.playlist_start),
            Media(options.border, options.fps, options.hwdec),
            GlRenderer(window.context, room, path, window.bits),
            window,
            RoomInUse(options.calibration, room, lambda: room_of(options), renewed),
            view=options.view,
            compensation=options.compensation,
            governor=_governor(options, room, room.default_steps),
            appraised=options.stats is not None,
            adjustments=adjustments,
            lasting=options.lasting or bool(remotes),
            loop_file=options.loop and len(options.media) == 1,
            speed=options.speed,
            start_s=options.start,
            image_display_duration=image_display_duration(options),
            blackout=options.blackout,
            osd=options.osd,
            unattended=options.supervised,
            screenshots=options.screenshot_directory,
            audio=audio,
            silence=silence,
        )
        del room  # a reload shall free it

        def shown() -> Any:
            assert isinstance(session.renderer, GlRenderer)
            return session.renderer.encoded_texture

        window.attach(shown, lambda: session.rendered_view == "projector")
        checks = checks_of(options)
        beside = in_step_of(options, session, stack)
        lamps = lamps_of(options, stack)
        show = Show(
            session,
            bindings=options.keys,
            remotes=remotes,
            heartbeat=heartbeat,
            checks=checks,
            lamps=lamps,
            beside=beside,
        )
        return show.run(options.frames)


if __name__ == "__main__":
    sys.exit(main())

"""Renders a medium into a file, whole or in segments, as the options of counterlight play ask."""

import argparse
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from counterlight.command import command_line, conclusion, tell
from counterlight.errors import InputError
from counterlight.jobs.workers import Processes, Workers
from counterlight.media.frames import MediaInfo
from counterlight.media.medium import Medium
from counterlight.media.sound_track import copied_sound
from counterlight.media.video import MediaReader
from counterlight.pipeline.adjustments import Adjustments
from counterlight.pipeline.refinement import STEPS_OF_A_STILL
from counterlight.pipeline.room import Room
from counterlight.show.from_options import backend_of, governor_of, path_of, steps_of
from counterlight.show.headless import chosen_backend, headless_renderer, render_to_file
from counterlight.show.options import OPTIONS
from counterlight.show.output import Coding, is_film, is_video
from counterlight.show.rendering import Rendering, Stretch
from counterlight.show.segmented import render_in_segments, tables_of
from counterlight.show.stats import Stats

SEGMENTS_A_WORKER = 2  # short segments, so that a slow or failed worker costs less waiting


def render(options: argparse.Namespace, read_room: Callable[[], Room], adjustments: Adjustments) -> Stats:
    """Render the medium of the options into its output file.

    Raises InputError for options that need a window, and for an output that would never end.

    read_room : called after the medium is open, because reading a large room takes a while.
    """
    _check(options)
    with MediaReader.open(one_medium(options), loop=options.loop, frames_per_second=options.fps) as reader:
        _check_medium(options, reader.info)
        if options.start:
            reader.seek(options.start)
        room = read_room()
        if unlit := room.seen_from(adjustments.viewpoint).unlit(reader.info.format, adjustments.corners):
            tell(unlit)
        stats = _rendered(options, reader, room, adjustments)
        for notice in reader.notices():
            tell(notice)
            stats.notice(notice)
    if room.drifted is not None:
        stats.facts["drift"] = room.drifted
    quality = stats.facts.get("camera_psnr_db")
    frames = "1 frame" if stats.frames == 1 else f"{stats.frames} frames"
    result = f"{options.output}: {frames}" + (f", camera PSNR {quality:.1f} dB over lit pixels" if quality else "")
    print(conclusion(result, _next(options)))
    return stats


def _next(options: argparse.Namespace) -> str:
    if options.view == "projector":
        return "show it on the projector with any player, full screen and unscaled"
    return command_line("play", options.calibration, *(medium.name for medium in options.media))


def _check(options: argparse.Namespace) -> None:
    if options.loop and options.frames is None:
        raise InputError("--loop with --output never ends; add --frames N")
    steps_of(options)
    if options.lead_in is not None and options.segments is options.cluster is None:
        raise InputError(f"--lead-in {options.lead_in}: is for segments; add --segments N")


def _check_medium(options: argparse.Namespace, info: MediaInfo) -> None:
    if info.live and options.frames is None:
        raise InputError(f"{info.path}: a live source never ends; add --frames N to --output")
    for line in ignored(options, info):
        tell(line)


def _rendered(options: argparse.Namespace, reader: MediaReader, room: Room, adjustments: Adjustments) -> Stats:
    backend = backend_of(options)
    if (options.segments or options.cluster) and is_film(options.output) and not reader.info.still:
        rendering, backend = _render_segments, chosen_backend(backend)
    else:
        rendering = _render_whole
    with _sound(options, reader) as sound:
        return rendering(options, reader, room, adjustments, backend, sound)


@contextmanager
def _sound(options: argparse.Namespace, reader: MediaReader) -> Iterator[Path | None]:
    """Yield the sound to write into the video, None if the output has no sound."""
    info = reader.info
    if not (options.audio and is_video(options.output) and info.sound) or info.still or info.live:
        yield None
    elif options.loop:
        tell("--loop: sound is copied once around only, so the output has none")
        yield None
    else:
        with copied_sound(reader.medium, options.start, tell) as sound:
            yield sound


def _render_whole(
    options: argparse.Namespace,
    reader: MediaReader,
    room: Room,
    adjustments: Adjustments,
    backend: str,
    sound: Path | None,
) -> Stats:
    with headless_renderer(backend, room, path_of(options)) as renderer:
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
            governor=governor_of(options, room, _steps_into_file(options, room, still=reader.info.still)),
            appraised=options.stats is not None,
            sound=sound,
            coding=coding_of(options),
        )


def _steps_into_file(options: argparse.Namespace, room: Room, *, still: bool) -> int:
    """Return the default number of steps. A still picture in a file gets more, because no frame rate limits it."""
    return STEPS_OF_A_STILL if still and room.default_steps and options.within == "no" else room.default_steps


def _render_segments(
    options: argparse.Namespace,
    reader: MediaReader,
    room: Room,
    adjustments: Adjustments,
    backend: str,
    sound: Path | None,
) -> Stats:
    if options.budget != "no" or options.within != "no":
        raise InputError(
            "--segments: --budget and --within carry steps from frame to frame; give a number of steps instead"
        )
    if reader.info.live:
        raise InputError(f"{reader.info.path}: a live source has no segments; leave out --segments")
    rendering = Rendering(
        calibration=options.calibration.absolute(),
        white=room.white,
        dither=options.dither,
        steps=governor_of(options, room, room.default_steps).steps,
        start=room.start,
        medium=replace(reader.medium, name=os.path.abspath(reader.medium.name)),
        loop=options.loop,
        frames_per_second=options.fps,
        start_s=options.start,
        frames=options.frames,
        backend=backend,
        path=path_of(options),
        view=options.view,
        compensate=options.compensation,
        adjustments=adjustments,
    )
    with _segment_workers(options, reader) as workers:
        count = options.segments or SEGMENTS_A_WORKER * workers.count
        stats = render_in_segments(
            rendering, reader, options.output, workers, count, options.lead_in, sound, coding_of(options)
        )
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


def coding_of(options: argparse.Namespace) -> Coding:
    """Return the coding of a video by the options."""
    return Coding(options.codec, options.pix_fmt, options.crf)


def one_medium(options: argparse.Namespace) -> Medium:
    """Return the medium to render into a file. Raises InputError unless exactly one medium is given."""
    if len(options.media) != 1:
        raise InputError(f"--output renders one medium, found {len(options.media)}; give one")
    medium: Medium = options.media[0]
    return medium


def ignored(options: argparse.Namespace, info: MediaInfo) -> list[str]:
    """Return one line for each given option that has no effect when this medium is rendered into a file."""
    in_windows = [name for name, row in OPTIONS.items() if row.needs == "window" and name in options.given]
    unused = [f"--{name}: is for a window, has no effect with --output" for name in in_windows]
    if options.output is not None and not is_film(options.output):
        names = [name for name in ("segments", "cluster") if name in options.given]
        unused += [f"--{name}: {options.output} is a single picture" for name in names]
    if info.still:
        unused += [
            f"--{name}: {info.path} is a single picture"
            for name in ("frames", "start", "segments", "cluster")
            if name in options.given
        ]
    if "fps" in options.given and not options.media[0].is_sequence:
        unused.append(f"--fps: {info.path} is no numbered sequence and has a rate of its own")
    return unused

"""play-corrected: show media through the correction map of a calibrated room."""

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Literal, TypeAlias

from player import calibration as calibrations
from player import maps
from player.command import Parser, run
from player.cpu_renderer import CpuRenderer
from player.errors import InputError
from player.headless import render_to_file
from player.refinement import DEFAULT_STEPS, MOST_STEPS, STARTS, StepBudget
from player.renderer import DITHERS, VIEWS, Renderer, Room
from player.session import Session
from player.stats import Stats
from player.video import MediaReader

Steps: TypeAlias = int | Literal["auto"] | None


def main(argv: Sequence[str] | None = None) -> int:
    return run(_main, argv)


def _main(argv: Sequence[str] | None) -> None:
    options = _parser().parse_args(argv)
    if options.list_monitors:
        from player.gl.monitors import list_monitors

        print("\n".join(str(monitor) for monitor in list_monitors()))
        return
    if options.stats is not None and not options.stats.parent.is_dir():
        raise InputError(f"{options.stats.parent}: no such folder for --stats; make it first")
    if options.calibration is None or options.media is None:
        raise InputError("play-corrected: needs a CALIBRATION and MEDIA; see play-corrected --help")
    room = read_room(options.calibration, options.white, options.dither, options.refine, options.refine_from)
    print(f"white is a camera radiance of {room.white:.4g}{' (auto)' if options.white is None else ''}")
    with MediaReader.open(options.media, loop=options.loop, frames_per_second=options.fps) as reader:
        if options.start and not (reader.info.still and not options.output):
            reader.seek(options.start)
        stats = _render(options, reader, room) if options.output else _play(options, reader, room)
        for notice in reader.notices():
            print(notice, file=sys.stderr)
            stats.notices.append(notice)
    if options.stats is not None:
        stats.write(options.stats)


def read_room(
    folder: Path, white: float | None, dither: str = "ordered", refine: Steps = None, start: str | None = None
) -> Room:
    """Read a calibration with its correction map; `white` None takes the level that most of the room can reach.

    refine : steps of refinement; None for the usual number where the room has the maps for it.
    start : one of STARTS, where they begin.
    """
    if refine == 0 and start is not None:
        raise InputError(
            f"--refine-from {start}: --refine 0 makes no step that could start there; leave one of them out"
        )
    stored = calibrations.read(folder)
    room_maps = maps.read_maps(stored, refinement=refine != 0)
    if (refine or start) and room_maps.refinement is None:
        raise InputError(
            f"{folder}: its maps were built without what refinement needs; "
            f"rebuild them with: build-correction-map {folder}, or leave out --refine and --refine-from"
        )
    return Room(stored.calibration, room_maps, room_maps.white if white is None else white, dither, start or STARTS[0])


@contextmanager
def headless_renderer(backend: str, room: Room) -> Iterator[Renderer]:
    """A renderer without a window: "gl" through EGL, or "cpu"."""
    if backend == "cpu":
        yield CpuRenderer(room)
        return
    from player.gl.context import headless_context
    from player.gl.renderer import GlRenderer

    with headless_context() as context:
        renderer = GlRenderer(context, room)
        try:
            yield renderer
        finally:
            renderer.release()


def _fixed_steps(refine: Steps, room: Room) -> int:
    """The steps of a frame if nothing is said of its time."""
    if isinstance(refine, int):
        return refine
    return DEFAULT_STEPS if room.maps.refinement is not None else 0


def _render(options: argparse.Namespace, reader: MediaReader, room: Room) -> Stats:
    if options.loop and options.frames is None:
        raise InputError("--loop with --output never ends; add --frames N")
    if options.refine == "auto":
        raise InputError("--refine auto is for a window: a file has no time to keep; give a number of steps")
    with headless_renderer(options.backend, room) as renderer:
        renderer.open(reader.info.format)
        stats = render_to_file(
            reader,
            renderer,
            room.calibration,
            options.output,
            options.view,
            compensate=not options.no_compensation,
            frames=options.frames,
            white=room.white,
            steps=_fixed_steps(options.refine, room),
        )
    quality = stats.facts.get("camera_psnr_db")
    print(f"{options.output}: {stats.frames} frames" + (f", camera PSNR {quality:.1f} dB" if quality else ""))
    return stats


def _play(options: argparse.Namespace, reader: MediaReader, room: Room) -> Stats:
    if options.backend == "cpu":
        raise InputError("--backend cpu has no window; add --output FILE")
    from player.gl.monitors import find_monitor, list_monitors
    from player.gl.renderer import GlRenderer
    from player.gl.window import open_window

    monitors = list_monitors()
    monitor = None if options.monitor is None else find_monitor(monitors, options.monitor)
    if monitor is None and options.fullscreen:
        monitor = find_monitor(monitors, 0)
    shape = room.calibration.projector.shape
    with open_window(
        shape,
        f"{options.media} - Counterlight",
        monitor=monitor,
        fullscreen=options.fullscreen,
        exact=not options.any_size,
        vsync=not options.no_vsync,
    ) as window:
        renderer = GlRenderer(window.context, room)
        try:
            renderer.open(reader.info.format)
            window.attach(lambda: renderer.encoded_texture)
            session = Session(
                reader,
                renderer,
                window,
                view=options.view,
                compensate=not options.no_compensation,
                steps=_fixed_steps(options.refine, room),
                budget=StepBudget(1 / reader.info.frames_per_second) if options.refine == "auto" else None,
            )
            return session.run(options.frames)
        finally:
            renderer.release()


def _parser() -> argparse.ArgumentParser:
    parser = Parser("play-corrected", description=__doc__, epilog=KEYS, formatter_class=argparse.RawTextHelpFormatter)
    add: Callable[..., object] = parser.add_argument
    add("calibration", type=Path, nargs="?", help="a calibration folder with its correction map")
    add(
        "media",
        nargs="?",
        help="a video, a picture, or a sequence such as name%%05d.png; .exr is camera radiance as is",
    )
    add(
        "--white",
        type=_white,
        metavar="auto|LEVEL",
        help="camera radiance of a white picture (default auto:\nthe level that nine in ten camera pixels can reach)",
    )
    add(
        "--refine",
        type=_steps,
        metavar="N|auto",
        help=f"steps a frame towards the best picture (default {DEFAULT_STEPS};\n"
        "auto: as many as the frame time leaves; 0: the correction map alone)",
    )
    add(
        "--refine-from",
        choices=STARTS,
        help="where they start (default previous: the correction map's\npicture, changed as in the frame before)",
    )
    add("--no-compensation", action="store_true", help="show the picture as any player would")
    add(
        "--view",
        choices=VIEWS,
        default="projector",
        help="what to show: the projector's picture, what the camera will\n"
        "see of it, or that without and with compensation",
    )
    add("--loop", action="store_true", help="start again at the end")
    add("--start", type=_seconds, default=0.0, metavar="SECONDS", help="begin there")
    add("--frames", type=_count, metavar="N", help="stop after N frames")
    add("--fps", type=_rate, metavar="RATE", help="frames per second of a numbered sequence (default 25)")
    add("--fullscreen", action="store_true", help="fill the monitor")
    add("--monitor", metavar="NAME|INDEX", help="the projector's monitor")
    add("--list-monitors", action="store_true", help="list the monitors and end")
    add("--any-size", action="store_true", help="go full screen on a monitor that is not of the projector's size")
    add("--no-vsync", action="store_true", help="do not wait for the display's refresh")
    add(
        "--output",
        type=Path,
        metavar="FILE",
        help="render without a window into .png, .exr (linear), name%%05d.png,\n.mp4, .mov, .webm or .mkv (lossless)",
    )
    add("--backend", choices=("gl", "cpu"), default="gl", help="cpu: the numpy reference (with --output)")
    add("--dither", choices=DITHERS, default="ordered", help="how 8-bit steps are hidden (default ordered)")
    add("--stats", type=Path, metavar="FILE.json", help="write frames, drops and milliseconds")
    return parser


KEYS = """keys: space pause   ←→ ±5 s   ↑↓ ±60 s   c compensation   v view   i statistics   b blackout   f full screen
      [ ] refinement steps   s screenshot   q quit"""


def _white(text: str) -> float | None:
    return None if text == "auto" else _number(text, 1e-30, 1e30, "auto or a radiance above 0")


def _steps(text: str) -> Steps:
    if text == "auto":
        return "auto"
    if not (text.isdecimal() and int(text) <= MOST_STEPS):
        raise argparse.ArgumentTypeError(f"expected auto or a number of steps from 0 to {MOST_STEPS}, found {text!r}")
    return int(text)


def _seconds(text: str) -> float:
    return _number(text, 0.0, 1e9, "seconds from 0")


def _rate(text: str) -> float:
    return _number(text, 1e-3, 1e3, "frames per second above 0")


def _count(text: str) -> int:
    if not (text.isdecimal() and int(text)):
        raise argparse.ArgumentTypeError(f"expected a number of frames from 1, found {text!r}")
    return int(text)


def _number(text: str, low: float, high: float, expected: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not low <= value <= high:
        raise argparse.ArgumentTypeError(f"expected {expected}, found {text!r}")
    return value


if __name__ == "__main__":
    sys.exit(main())

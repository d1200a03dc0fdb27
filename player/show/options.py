"""The options of counterlight play, what they take, and the settings file that gives their defaults."""

import argparse
import os
from collections.abc import Callable, Sequence
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

from counterlight.calibration import RADIANCE
from counterlight.command import Parser
from counterlight.errors import InputError
from counterlight.media.decoding.devices import ANY, PROCESSOR, TYPES
from counterlight.media.medium import Border, Medium
from counterlight.pipeline.device import PATHS
from counterlight.pipeline.parameters import PARAMETERS
from counterlight.pipeline.refinement import STARTS
from counterlight.pipeline.room import DITHERS
from counterlight.pipeline.test_cards import CARDS
from counterlight.pipeline.value_types import Choice, Flag, Kind, Number, UnreadError
from counterlight.remote.addresses import LOOPBACK, Address, parse_address
from counterlight.show.headless import BACKENDS
from counterlight.show.in_step import begins_at
from counterlight.show.keys import KEYS, MEANINGS
from counterlight.show.playlist import expand
from counterlight.show.remotes import PORT as PAGE_PORT
from counterlight.show.settings import Several, apply_settings, default_path
from counterlight.unattended.cues import PORT, read_address
from counterlight.unattended.supervisor import SAFE


def read_options(argv: Sequence[str] | None, description: str) -> argparse.Namespace:
    """Read the options. The command line overrides the settings file, which overrides the defaults.

    Adds these attributes:
    given : names of the options whose value is not the default.
    keys : key bindings of the settings file.
    media : the media (media/medium.py), with the lists in `lists` expanded.
    border : the files that lists and remotes may name.
    lasting : whether the show must go on without a user.
    """
    parser = _parser(description)
    config = parser.parse_known_intermixed_args(argv)[0]
    keys: dict[str, str] = {}
    if not config.no_config:
        path = config.config or default_path(os.environ, Path.home())
        if config.config is not None or path.exists():
            keys = apply_settings(parser, path)
    options = parser.parse_intermixed_args(argv)
    options.given = {name for name, value in vars(options).items() if value != parser.get_default(name)}
    options.keys, options.lists = keys, [Medium(name) for name in options.media]
    roots = [options.media_root] if isinstance(options.media_root, Path) else options.media_root or []
    if not options.supervised:  # a folder may be mounted later
        _check_folders(roots)
    options.border = Border.around(options.lists, roots, live=options.allow_live)
    remotes = options.control, options.remote, options.osc
    options.lasting = options.loop or options.supervised or any(remote is not None for remote in remotes)
    options.media = expand(options.lists, options.border, patient=options.lasting)
    return options


def _check_folders(roots: Sequence[Path]) -> None:
    for root in roots:
        if not root.is_dir():
            raise InputError(f"--media-root {root}: no such folder; make it first, or check its name")


def _parser(description: str) -> argparse.ArgumentParser:
    parser = Parser(
        "play",
        description=description,
        epilog=_keys(),
        formatter_class=argparse.RawTextHelpFormatter,
        allow_abbrev=False,
    )
    for add in (_add_what, _add_border, _add_compensation, _add_adjustments, _add_window, _add_step, _add_output):
        add(parser)
    return parser


def _offer(parser: argparse.ArgumentParser, *names: str) -> None:
    """Add parameters of a show as options."""
    for name in names:
        row = PARAMETERS[name]
        if isinstance(row.kind, Flag):
            _flag(parser, name, row.default, row.help)
        elif isinstance(row.kind, Choice):
            parser.add_argument(f"--{name}", choices=row.kind.words, default=row.default, help=row.help)
        else:
            unsaid = row.unsaid or f"{row.default:g}"
            _number(parser, name, row.kind, row.value, f"{row.help}; {row.kind}\n(default {unsaid})", row.default)


def _flag(parser: argparse.ArgumentParser, name: str, default: bool, text: str) -> None:
    parser.add_argument(f"--{name}", action=argparse.BooleanOptionalAction, default=default, help=text)


def _number(
    parser: argparse.ArgumentParser, name: str, kind: Kind, metavar: str, text: str, default: object = None
) -> None:
    def read(word: str) -> Any:
        try:
            return kind.read(word)
        except UnreadError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    parser.add_argument(f"--{name}", type=read, default=default, metavar=metavar, help=text)


def _add_what(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("calibration", type=Path, nargs="?", help="a calibration folder with its correction map")
    add(
        "media",
        nargs="*",
        help="videos, pictures, sequences such as name%%05d.png, lists of them (.m3u, .txt);\n"
        ".exr is camera radiance as is",
    )
    _flag(parser, "loop", False, "start again at the end")
    _number(parser, "start", Number(0, 1e9, noun="seconds"), "SECONDS", "begin there", 0.0)
    position = Number(0, 1e9, whole=True, noun="a position in the list")
    _number(parser, "playlist-start", position, "N", "begin with that medium of several, from 0", 0)
    _number(parser, "frames", Number(1, 1e9, whole=True, noun="a number of frames"), "N", "stop after N frames")
    rate = Number(1e-3, 1e3, noun="frames per second")
    _number(parser, "fps", rate, "RATE", "frames per second of a numbered sequence (default 25)")
    _offer(parser, "speed", "image-display-duration", "keep-open", "fade", "crossfade")
    text = f"what decodes films: no, the processor (default); auto; or a GPU as FFmpeg\nnames it: {', '.join(TYPES)}"
    parser.add_argument("--hwdec", type=_device, default=PROCESSOR, metavar="TYPE[:DEVICE]", help=text)


def _add_border(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--media-root",
        action=Several,
        type=Path,
        metavar="DIR",
        help="lists and remotes may name files below it, too; several: each once\n"
        "(always: below a list's own folder, and below those of the MEDIA)",
    )
    _flag(parser, "allow-live", False, "lists and remotes may name streams (rtsp://, udp://, …), too")


def _add_compensation(parser: argparse.ArgumentParser) -> None:
    text = "camera radiance of a white picture (default auto:\nthe level that nine in ten camera pixels can reach)"
    white = Number(*RADIANCE, words=("auto",), noun="a radiance")
    _number(parser, "white", white, "auto|LEVEL", text, "auto")
    _offer(parser, "refine", "budget", "within")
    parser.add_argument(
        "--refine-from",
        choices=STARTS,
        help="where they start (default: as the maps say, the correction map's\n"
        "picture, or direct mapping's if that map is large, both changed\nas in the frame before)",
    )
    _offer(parser, "compensation", "view", "viewpoint")


def _add_adjustments(parser: argparse.ArgumentParser) -> None:
    _offer(parser, "brightness", "contrast", "gamma", "saturation", "black-level", "adapt", "flicker", "clipping")
    _offer(parser, "target-peak", "hdr-peak", "tone-mapping")
    parser.add_argument("--lut", type=Path, metavar="FILE.cube", help="colour table that codes go through")
    _offer(parser, "lut-type")
    parser.add_argument("--test-card", dest="card", choices=CARDS, help=PARAMETERS["test-card"].help)


def _add_window(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    _offer(parser, "fullscreen")
    add(
        "--monitor",
        action=Several,
        metavar="NAME|INDEX",
        help="the projector's monitor; several: one after the other\n(default: as the calibration says, or the first)",
    )
    add("--list-monitors", action="store_true", help="list the monitors and end")
    _flag(parser, "any-size", False, "go full screen on a monitor that is not of the projector's size")
    _flag(parser, "vsync", True, "wait for the display's refresh")
    _flag(parser, "audio", True, "play sound, if the extra audio is there; with --output, copy it into a film")
    _offer(parser, "volume", "mute", "blackout", "osd")
    add("--screenshot-directory", type=Path, default=Path(), metavar="DIR", help="for the key s (default: here)")
    add("--config", type=Path, metavar="FILE", help="settings (default ~/.config/counterlight/player.toml)")
    add("--no-config", action="store_true", help="read no settings")


def _add_step(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    text = "tell followers where the show is, on this UDP port"
    add("--lead", type=_address(host=""), metavar="[HOST:]PORT", help=text)
    text = f"go where the leader on another machine is\n(its port: {PORT} if left out)"
    add("--follow", type=_address(port=PORT), metavar="HOST[:PORT]", help=text)
    add("--at", type=_time_of_day, metavar="HH:MM:SS", help="begin at this time of the day, black until then")


def _address(**defaults: Any) -> Callable[[str], tuple[str, int]]:
    def read(word: str) -> tuple[str, int]:
        try:
            return read_address(word, **defaults)
        except ValueError:
            expected = "[HOST:]PORT" if "host" in defaults else "HOST[:PORT]"
            raise argparse.ArgumentTypeError(f"expected {expected}, found {word!r}") from None

    return read


def _device(word: str) -> str:
    if word.partition(":")[0] not in (PROCESSOR, ANY, *TYPES):
        raise argparse.ArgumentTypeError(f"expected {PROCESSOR}, {ANY} or one of {', '.join(TYPES)}, found {word!r}")
    return word


def _time_of_day(word: str) -> datetime:
    try:
        return begins_at(word, datetime.now())
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected a time such as 20:00:00, found {word!r}") from None


def _add_output(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add(
        "--output",
        type=Path,
        metavar="FILE",
        help="render without a window into .png, .exr (linear), name%%05d.png,\n.mp4, .mov, .webm or .mkv (lossless)",
    )
    add(
        "--backend",
        choices=BACKENDS,
        default="auto",
        help="what renders: gl, OpenGL, or cpu, compiled for the processor\n"
        "(default auto: gl where there is a GPU, or --path is given, else cpu)",
    )
    add(
        "--path",
        choices=PATHS,
        help="how the GPU multiplies: fragment or compute shaders (OpenGL 4.3),\n"
        "words or compute-words with T in words of 4 bytes; auto measures at\n"
        "the start and keeps the fastest (default: auto in a window with a GPU;\n"
        "fragment with --output, so that its result repeats)",
    )
    add("--codec", metavar="NAME", help="of a video, FFmpeg's encoder (default libx264; .webm libvpx-vp9; .mkv ffv1)")
    text = "FFmpeg's pixel format, such as yuv444p\n(default yuv420p, yuv444p for odd sizes; ffv1 bgr0)"
    add("--pix-fmt", metavar="NAME", help=text)
    text = "FFmpeg's quality, lower is better; 0 to 63 (default 14, which looks\nlossless)"
    _number(parser, "crf", Number(0, 63), "N", text)
    whole = Number(1, 999, whole=True, noun="a number of segments")
    text = "render a film in N segments at a time, each in a process of its own,\nand join them (docs/size.md)"
    _number(parser, "segments", whole, "N", text)
    text = "begin segments within shots, too, so many frames early\n(default: at cuts alone, so that nothing changes)"
    _number(parser, "lead-in", Number(0, 1e6, whole=True, noun="a number of frames"), "FRAMES", text)
    text = "HOST:PORT of a dask scheduler, or local:N: who renders the segments\n(extra cluster, docs/size.md)"
    add("--cluster", metavar="ADDRESS", help=text)
    add("--dither", choices=DITHERS, default="ordered", help="how steps of a code value are hidden (default ordered)")
    add(
        "--bits",
        choices=("auto", "8", "10"),
        default="auto",
        help="of a code value in a window (default auto: as the monitors are set)",
    )
    add("--control", type=Path, metavar="SOCKET", help="take commands there, JSON lines as mpv's IPC")
    add(
        "--remote",
        type=partial(parse_address, port=PAGE_PORT),
        nargs="?",
        const=Address(LOOPBACK, PAGE_PORT),
        metavar="HOST:PORT",
        help=f"serve a page for browsers there (default {LOOPBACK}:{PAGE_PORT}, this machine\n"
        "alone; 0.0.0.0: the network); it prints its address, with the token",
    )
    add("--osc", type=parse_address, metavar="[HOST:]PORT", help="take Open Sound Control there (UDP)")
    add("--heartbeat", metavar="FILE|-", help="add a JSON line a second: frames, drops, memory, position")
    minutes = Number(1 / 60, 1e6, noun="minutes")
    text = "look at the room again so often, between two media if there\nare several, and correct what has moved"
    _number(parser, "check-every", minutes, "MINUTES", text)
    add(
        "--check-with",
        metavar="'OPTIONS'",
        help="of counterlight verify: --camera CAMERA and what belongs to it;\nalone: for check-room",
    )
    _flag(parser, "supervise", False, "start the player again whenever it dies or hangs")
    add("--supervised", action="store_true", help=argparse.SUPPRESS)  # set by the supervisor
    add("--safe", choices=SAFE, default="black", help="what --supervise shows after too many crashes (default black)")
    text = (
        "TOML: when the show plays, by day and hour, and projectors that\n"
        "are switched on and off for it (PJLink); with --supervise"
    )
    add("--schedule", type=Path, metavar="FILE", help=text)
    add("--stats", type=Path, metavar="FILE.json", help="write frames, drops, judder and milliseconds")


def _keys() -> str:
    """Return the keys in lines of a terminal's width."""
    lines = ["keys (? lists them over the picture):"]
    for key, command in KEYS.items():
        piece = f"{key} {MEANINGS[command]}"
        if len(lines[-1]) + len(piece) > 100 or len(lines) == 1:
            lines.append("  " + piece)
        else:
            lines[-1] += f",  {piece}"
    return "\n".join(lines).replace("%", "%%")

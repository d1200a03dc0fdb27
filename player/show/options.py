"""The options of counterlight play, what they take, and the settings file that gives their defaults."""

import argparse
import os
from collections.abc import Callable, Sequence
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

from counterlight.calibration import RADIANCE
from counterlight.command import Arguments, Parser
from counterlight.errors import InputError
from counterlight.media.decoding.devices import ANY, PROCESSOR, TYPES
from counterlight.media.medium import Border, Medium
from counterlight.pipeline.device import BACKENDS, PATHS
from counterlight.pipeline.parameters import PARAMETERS
from counterlight.pipeline.refinement import STARTS
from counterlight.pipeline.room import DITHERS
from counterlight.pipeline.test_cards import CARDS
from counterlight.pipeline.value_types import MANY, Choice, Flag, Kind, Number, UnreadError
from counterlight.remote.addresses import LOOPBACK, Address, parse_address
from counterlight.show.in_step import begins_at
from counterlight.show.keys import KEYS, MEANINGS
from counterlight.show.playlist import expand
from counterlight.show.remotes import PORT as PAGE_PORT
from counterlight.show.settings import Several, apply_settings, default_path
from counterlight.unattended.cues import PORT, read_address
from counterlight.unattended.supervisor import SAFE

EXAMPLES = (
    "counterlight play room film.mp4 --fullscreen --loop",
    "counterlight play room film.mp4 --output for_projector.mp4",
)
COMMON = (
    *("--loop", "--image-display-duration", "--fade", "--crossfade"),
    *("--view", "--brightness", "--contrast", "--gamma", "--saturation", "--white", "--refine"),
    *("--fullscreen", "--monitor", "--volume", "--output", "--supervise", "--schedule", "--remote"),
)


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
        "play", description=description, epilog=_keys(), examples=EXAMPLES, common=COMMON, allow_abbrev=False
    )
    parser.add_argument("calibration", type=Path, nargs="?", help="calibration folder with a correction map")
    parser.add_argument(
        "media",
        nargs="*",
        help="videos, pictures (.exr: camera radiance), numbered pictures such as name%%05d.png, or lists (.m3u, .txt)",
    )
    for title, add in GROUPS.items():
        add(parser.add_argument_group(title))
    return parser


def _offer(group: Arguments, *names: str) -> None:
    """Add parameters of a show as options."""
    for name in names:
        row = PARAMETERS[name]
        if isinstance(row.kind, Flag):
            _flag(group, name, row.default, row.help)
        elif isinstance(row.kind, Choice):
            text = f"{row.help} (default {row.default})"
            group.add_argument(f"--{name}", choices=row.kind.words, default=row.default, help=text)
        else:
            unsaid = f"default: {row.unsaid}" if " " in row.unsaid else f"default {row.unsaid or f'{row.default:g}'}"
            bounds = f"{row.kind.bounds}, " if isinstance(row.kind, Number) and row.kind.high < MANY else ""
            _number(group, name, row.kind, row.value, f"{row.help} ({bounds}{unsaid})", row.default)


def _flag(group: Arguments, name: str, default: bool, text: str) -> None:
    stated = f"{text} (default yes)" if default else text
    group.add_argument(f"--{name}", action=argparse.BooleanOptionalAction, default=default, help=stated)


def _number(group: Arguments, name: str, kind: Kind, metavar: str, text: str, default: object = None) -> None:
    def read(word: str) -> Any:
        try:
            return kind.read(word)
        except UnreadError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    group.add_argument(f"--{name}", type=read, default=default, metavar=metavar, help=text)


def _add_media(group: Arguments) -> None:
    _flag(group, "loop", False, "start again at the end")
    _offer(group, "image-display-duration", "fade", "crossfade", "speed", "keep-open")
    seconds = Number(0, 1e9, noun="seconds")
    _number(group, "start", seconds, "SECONDS", "start at this time of the first medium (default 0)", 0.0)
    position = Number(0, 1e9, whole=True, noun="a position in the list")
    _number(group, "playlist-start", position, "N", "start with this medium of the list, counted from 0 (default 0)", 0)
    count = Number(1, 1e9, whole=True, noun="a number of frames")
    _number(group, "frames", count, "N", "stop after N frames (default: at the end)")
    rate = Number(1e-3, 1e3, noun="frames per second")
    _number(group, "fps", rate, "RATE", "set the frames per second of a numbered sequence (default 25)")
    group.add_argument(
        "--hwdec",
        type=_device,
        default=PROCESSOR,
        metavar="TYPE[:DEVICE]",
        help=f"decode films on the processor (no, the default), or on a GPU: auto, {', '.join(TYPES)}",
    )
    group.add_argument(
        "--media-root",
        action=Several,
        type=Path,
        metavar="DIR",
        help="let lists and remotes name files below this folder; may be repeated (default: folders of the lists and "
        "of the media)",
    )
    _flag(group, "allow-live", False, "let lists and remotes name streams (rtsp://, udp://)")


def _add_picture(group: Arguments) -> None:
    _offer(group, "view", "brightness", "contrast", "gamma", "saturation", "black-level", "adapt", "flicker")
    _offer(group, "clipping", "target-peak", "hdr-peak", "tone-mapping")
    group.add_argument(
        "--lut", type=Path, metavar="FILE.cube", help="apply a colour table to the media (default: none)"
    )
    _offer(group, "lut-type")
    row = PARAMETERS["test-card"]
    group.add_argument("--test-card", dest="card", choices=CARDS, help=f"{row.help} (default: none)")


def _add_compensation(group: Arguments) -> None:
    text = "set the camera radiance of white; auto: what nine of ten camera pixels can reach (default auto)"
    white = Number(*RADIANCE, words=("auto",), noun="a radiance")
    _number(group, "white", white, "auto|LEVEL", text, "auto")
    _offer(group, "compensation", "refine")
    group.add_argument(
        "--refine-from",
        choices=STARTS,
        help="start the refinement from the frame before (changed by the correction map or by direct mapping), the "
        "correction map, direct mapping, or grey (default: as the build found)",
    )
    _offer(group, "budget", "within", "viewpoint")


def _add_window(group: Arguments) -> None:
    _offer(group, "fullscreen")
    group.add_argument(
        "--monitor",
        action=Several,
        metavar="NAME|N",
        help="show on this monitor of --list-monitors; may be repeated (default: the calibration's, or the first)",
    )
    group.add_argument("--list-monitors", action="store_true", help="list the monitors and exit")
    _flag(group, "any-size", False, "fill a monitor that does not have the projector's size")
    _flag(group, "vsync", True, "wait for the display's refresh")
    _flag(group, "audio", True, "play the sound, or copy it into the file of --output")
    _offer(group, "volume", "mute", "blackout", "osd")
    group.add_argument(
        "--screenshot-directory",
        type=Path,
        default=Path(),
        metavar="DIR",
        help="save the pictures of key s in this folder (default: the current folder)",
    )
    group.add_argument(
        "--bits",
        choices=("auto", "8", "10"),
        default="auto",
        help="set the bits of a code value in a window (default auto: as the monitors are set)",
    )


def _add_output(group: Arguments) -> None:
    add = group.add_argument
    add(
        "--output",
        type=Path,
        metavar="FILE",
        help="render into a file without a window: .mp4, .mov, .webm, .mkv (lossless), .png, .exr, or name%%05d.png",
    )
    add(
        "--codec",
        metavar="NAME",
        help="use this encoder of FFmpeg (default libx264; libvpx-vp9 in .webm, ffv1 in .mkv)",
    )
    add(
        "--pix-fmt",
        metavar="NAME",
        help="use this pixel format of FFmpeg, such as yuv444p (default yuv420p; yuv444p for odd sizes, bgr0 for ffv1)",
    )
    text = "set FFmpeg's quality, 0 to 63; lower is better (default 14, visually lossless)"
    _number(group, "crf", Number(0, 63), "N", text)
    whole = Number(1, 999, whole=True, noun="a number of segments")
    text = "render a film in N segments, each in its own process, and join them (docs/size.md; default 1)"
    _number(group, "segments", whole, "N", text)
    text = "also divide shots; each segment then starts this many frames early (default: divide at cuts only)"
    _number(group, "lead-in", Number(0, 1e6, whole=True, noun="a number of frames"), "FRAMES", text)
    add(
        "--cluster",
        metavar="ADDRESS",
        help="render the segments on the dask scheduler at HOST:PORT, or in N local processes with local:N (extra "
        "cluster, docs/size.md; default: in this process)",
    )


def _add_drawing(group: Arguments) -> None:
    add = group.add_argument
    add(
        "--backend",
        choices=BACKENDS,
        default="auto",
        help="draw with OpenGL (gl) or on the processor (cpu); auto: gl with a GPU or --path, otherwise cpu (default "
        "auto)",
    )
    add(
        "--path",
        choices=PATHS,
        help="choose the GPU's shaders: fragment or compute; with words, entries take 4 bytes instead of 16. auto: the "
        " fastest, measured at startup (default auto in a window with a GPU, otherwise fragment)",
    )
    add(
        "--dither",
        choices=DITHERS,
        default="ordered",
        help="hide the steps between code values by a pattern, by noise, or not at all (default ordered)",
    )
    add("--stats", type=Path, metavar="FILE.json", help="write counts of frames and times in milliseconds to this file")
    add(
        "--config",
        type=Path,
        metavar="FILE",
        help="read settings from this file (default ~/.config/counterlight/player.toml)",
    )
    add("--no-config", action="store_true", help="read no settings file")


def _add_show(group: Arguments) -> None:
    add = group.add_argument
    _flag(group, "supervise", False, "restart the player whenever it crashes or hangs")
    add("--supervised", action="store_true", help=argparse.SUPPRESS)  # set by the supervisor
    add("--at", type=_time_of_day, metavar="HH:MM:SS", help="start at this time of day; black until then")
    add(
        "--schedule",
        type=Path,
        metavar="FILE",
        help="play in the hours of this file; needs --supervise",
    )
    text = "show this after too many crashes: black, or the media without compensation (default black)"
    add("--safe", choices=SAFE, default="black", help=text)
    text = "append a JSON line per second: frames, drops, memory, position (-: standard error)"
    add("--heartbeat", metavar="FILE|-", help=text)
    minutes = Number(1 / 60, 1e6, noun="minutes")
    text = "check the room this often, between two media if possible, and correct what has moved"
    _number(group, "check-every", minutes, "MINUTES", text)
    add(
        "--check-with",
        metavar="'OPTIONS'",
        help="pass these options to counterlight verify, such as '--camera v4l2:0'; check-room uses them, too",
    )
    add(
        "--remote",
        type=partial(parse_address, port=PAGE_PORT),
        nargs="?",
        const=Address(LOOPBACK, PAGE_PORT),
        metavar="HOST:PORT",
        help=f"serve a page for browsers (default {LOOPBACK}:{PAGE_PORT}; 0.0.0.0: to the whole network)",
    )
    add("--osc", type=parse_address, metavar="[HOST:]PORT", help="accept Open Sound Control messages on this UDP port")
    add("--control", type=Path, metavar="SOCKET", help="accept JSON commands on this socket, as in mpv's IPC")
    text = "send the time of the show to followers on this UDP port"
    add("--lead", type=_address(host=""), metavar="[HOST:]PORT", help=text)
    text = f"follow the leader on another machine (default port {PORT})"
    add("--follow", type=_address(port=PORT), metavar="HOST[:PORT]", help=text)


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


def _keys() -> str:
    """Return a list of the keys and their meanings, one line per meaning."""
    keys: dict[str, list[str]] = {}
    for key, command in KEYS.items():
        keys.setdefault(MEANINGS[command], []).append(key)
    return "\n".join(["keys:", *(f"  {', '.join(names):<21} {meaning}" for meaning, names in keys.items())])


GROUPS = {
    "media": _add_media,
    "picture": _add_picture,
    "compensation": _add_compensation,
    "window and sound": _add_window,
    "output to a file": _add_output,
    "running a show": _add_show,
    "drawing and settings": _add_drawing,
}

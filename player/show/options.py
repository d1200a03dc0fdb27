"""The options of counterlight play, what they take, and the settings file that gives their defaults."""

import argparse
import os
from collections.abc import Callable, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Literal, TypeAlias

from counterlight.adjustments import CONTROL, MOST_BLACK, MOST_FLICKER, Adjustments
from counterlight.calibration import RADIANCE
from counterlight.command import Parser
from counterlight.errors import InputError
from counterlight.medium import Border, Medium
from counterlight.refinement import DEFAULT_STEPS, MOST_STEPS, STARTS, STEPS_WITHOUT_MAP
from counterlight.renderer import DITHERS, PATHS, VIEWS
from counterlight.show.keys import KEYS
from counterlight.show.playlist import expand
from counterlight.show.settings import Several, apply_settings, default_path
from counterlight.test_cards import CARDS
from counterlight.unattended.supervisor import SAFE

Steps: TypeAlias = int | Literal["auto"] | None
LISTED_IMAGE_S = 5.0  # how long a picture in a list is shown if nobody says


def read_options(argv: Sequence[str] | None, description: str) -> argparse.Namespace:
    """Options over settings over defaults.

    keys : the settings' key bindings.  media : player/medium.py, `lists` expanded.  border : what others may name.
    lasting : whether nobody is there to start the show again.
    """
    parser = _parser(description)
    config = parser.parse_known_intermixed_args(argv)[0]
    keys: dict[str, str] = {}
    if not config.no_config:
        path = config.config or default_path(os.environ, Path.home())
        if config.config is not None or path.exists():
            keys = apply_settings(parser, path)
    options = parser.parse_intermixed_args(argv)
    options.keys, options.lists = keys, [Medium(name) for name in options.media]
    roots = [options.media_root] if isinstance(options.media_root, Path) else options.media_root or []
    options.border = Border.around(options.lists, roots, live=options.allow_live)
    options.lasting = options.loop or options.supervised or options.control is not None
    options.media = expand(options.lists, options.border, patient=options.lasting)
    return options


def adjustments_of(options: argparse.Namespace) -> Adjustments:
    """The viewer's settings among the options."""
    return Adjustments(
        **{field.name: getattr(options, field.name) for field in fields(Adjustments) if field.name in options}
    )


def monitors_of(options: argparse.Namespace) -> list[str]:
    """The monitors that are named, one for each projector; settings may name a single one without a list."""
    return [options.monitor] if isinstance(options.monitor, str) else options.monitor or []


def image_display_duration(options: argparse.Namespace) -> float | None:
    """Seconds that a picture is shown; None for ever, which is what a single medium gets."""
    given = options.image_display_duration
    if given is None:
        return LISTED_IMAGE_S if len(options.media) > 1 else None
    return None if given == float("inf") else float(given)


def _parser(description: str) -> argparse.ArgumentParser:
    parser = Parser(
        "play",
        description=description,
        epilog=_keys(),
        formatter_class=argparse.RawTextHelpFormatter,
        allow_abbrev=False,
    )
    _add_what(parser.add_argument)
    _add_border(parser.add_argument)
    _add_compensation(parser.add_argument)
    _add_picture(parser.add_argument)
    _add_window(parser.add_argument)
    _add_output(parser.add_argument)
    return parser


def _add_what(add: Callable[..., object]) -> None:
    add("calibration", type=Path, nargs="?", help="a calibration folder with its correction map")
    add(
        "media",
        nargs="*",
        help="videos, pictures, sequences such as name%%05d.png, lists of them (.m3u, .txt);\n"
        ".exr is camera radiance as is",
    )
    add("--loop", action=argparse.BooleanOptionalAction, default=False, help="start again at the end")
    add("--start", type=_seconds, default=0.0, metavar="SECONDS", help="begin there")
    add("--playlist-start", type=_position, default=0, metavar="N", help="begin with that medium of several, from 0")
    add("--frames", type=_count, metavar="N", help="stop after N frames")
    add("--fps", type=_rate, metavar="RATE", help="frames per second of a numbered sequence (default 25)")
    add("--speed", type=_within(0.01, 100), default=1.0, metavar="FACTOR", help="media seconds a second (default 1)")
    add(
        "--image-display-duration",
        type=_hold,
        metavar="SECONDS|inf",
        help=f"how long a picture is shown (default inf, in a list {LISTED_IMAGE_S:g})",
    )


def _add_border(add: Callable[..., object]) -> None:
    add(
        "--media-root",
        action=Several,
        type=Path,
        metavar="DIR",
        help="lists and remotes may name files below it, too; several: each once\n"
        "(always: below a list's own folder, and below those of the MEDIA)",
    )
    add(
        "--allow-live",
        action=argparse.BooleanOptionalAction,
        default=False,
        help="lists and remotes may name streams (rtsp://, udp://, …), too",
    )


def _add_compensation(add: Callable[..., object]) -> None:
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
        help=f"steps a frame towards the best picture (default {DEFAULT_STEPS}, from\n"
        f"direct mapping {STEPS_WITHOUT_MAP}; auto: as many as the frame time leaves;\n"
        "0: the correction map alone)",
    )
    add(
        "--refine-from",
        choices=STARTS,
        help="where they start (default: the correction map's picture,\n"
        "or, if that map is large, direct mapping's, both changed\nas in the frame before)",
    )
    add(
        "--compensation",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="without it: show the picture as any player would",
    )
    add(
        "--view",
        choices=VIEWS,
        default="projector",
        help="what to show: the projector's picture, what the camera will\n"
        "see of it, or that without and with compensation",
    )


def _add_picture(add: Callable[..., object]) -> None:
    for name in ("brightness", "contrast", "gamma", "saturation"):
        add(f"--{name}", type=_control, default=0, metavar="N", help=f"{-CONTROL} to {CONTROL} (default 0)")
    add("--black-level", type=_within(0, MOST_BLACK), default=0.0, metavar="SHARE", help="of white, asked for by black")
    add(
        "--adapt", type=_within(0, 100), default=0.0, metavar="PERCENT", help="of the light that may clip (default off)"
    )
    add(
        "--flicker",
        type=_within(0, MOST_FLICKER),
        default=0.0,
        metavar="WEIGHT",
        help="of the frame before (default 0)",
    )
    add("--clipping", action=argparse.BooleanOptionalAction, default=False, help="colour what clips")
    add("--test-card", dest="card", choices=CARDS, help="show a test card instead of the picture")


def _add_window(add: Callable[..., object]) -> None:
    add("--fullscreen", action=argparse.BooleanOptionalAction, default=False, help="fill the monitor")
    add(
        "--monitor",
        action=Several,
        metavar="NAME|INDEX",
        help="the projector's monitor; several: one after the other\n(default: as the calibration says, or the first)",
    )
    add("--list-monitors", action="store_true", help="list the monitors and end")
    add(
        "--any-size",
        action=argparse.BooleanOptionalAction,
        default=False,
        help="go full screen on a monitor that is not of the projector's size",
    )
    add(
        "--vsync",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="wait for the display's refresh",
    )
    add("--audio", action=argparse.BooleanOptionalAction, default=True, help="play sound, if the extra audio is there")
    add("--volume", type=_within(0, 130), default=100.0, metavar="PERCENT", help="of the sound (default 100)")
    add("--mute", action=argparse.BooleanOptionalAction, default=False, help="begin without sound")
    add("--blackout", action=argparse.BooleanOptionalAction, default=False, help="begin with black")
    add("--osd", action=argparse.BooleanOptionalAction, default=True, help="say on the screen what keys change")
    add("--screenshot-directory", type=Path, default=Path(), metavar="DIR", help="for the key s (default: here)")
    add("--config", type=Path, metavar="FILE", help="settings (default ~/.config/counterlight/player.toml)")
    add("--no-config", action="store_true", help="read no settings")


def _add_output(add: Callable[..., object]) -> None:
    add(
        "--output",
        type=Path,
        metavar="FILE",
        help="render without a window into .png, .exr (linear), name%%05d.png,\n.mp4, .mov, .webm or .mkv (lossless)",
    )
    add("--backend", choices=("gl", "cpu"), default="gl", help="cpu: the numpy reference (with --output)")
    add(
        "--path",
        choices=PATHS,
        help="how the GPU multiplies: fragment or compute shaders (OpenGL 4.3);\n"
        "auto measures both at the start and keeps the faster (default: auto\n"
        "in a window; fragment with --output, so that its result repeats)",
    )
    add("--dither", choices=DITHERS, default="ordered", help="how 8-bit steps are hidden (default ordered)")
    add("--control", type=Path, metavar="SOCKET", help="take commands there, JSON lines as mpv's IPC")
    add("--heartbeat", metavar="FILE|-", help="add a JSON line a second: frames, drops, memory, position")
    add(
        "--supervise",
        action=argparse.BooleanOptionalAction,
        default=False,
        help="start the player again whenever it dies or hangs",
    )
    add("--supervised", action="store_true", help=argparse.SUPPRESS)  # said by the supervisor
    add("--safe", choices=SAFE, default="black", help="what --supervise shows after too many crashes (default black)")
    add("--stats", type=Path, metavar="FILE.json", help="write frames, drops, judder and milliseconds")


def _keys() -> str:
    """The keys in lines of a terminal's width."""
    lines = ["keys (? lists them over the picture):"]
    for key, words in KEYS.items():
        piece = f"{key} {words}"
        if len(lines[-1]) + len(piece) > 100 or len(lines) == 1:
            lines.append("  " + piece)
        else:
            lines[-1] += f",  {piece}"
    return "\n".join(lines).replace("%", "%%")


def _white(text: str) -> float | None:
    return None if text == "auto" else _number(text, *RADIANCE, "auto or a radiance, {:g} to {:g}".format(*RADIANCE))


def _steps(text: str) -> Steps:
    if text == "auto":
        return "auto"
    if not (text.isdecimal() and int(text) <= MOST_STEPS):
        raise argparse.ArgumentTypeError(f"expected auto or a number of steps from 0 to {MOST_STEPS}, found {text!r}")
    return int(text)


def _hold(text: str) -> float:
    return float("inf") if text == "inf" else _number(text, 0.01, 1e6, "inf or seconds from 0.01")


def _seconds(text: str) -> float:
    return _number(text, 0.0, 1e9, "seconds from 0")


def _rate(text: str) -> float:
    return _number(text, 1e-3, 1e3, "frames per second above 0")


def _control(text: str) -> int:
    if not (text.removeprefix("-").isdecimal() and abs(int(text)) <= CONTROL):
        raise argparse.ArgumentTypeError(f"expected a whole number from {-CONTROL} to {CONTROL}, found {text!r}")
    return int(text)


def _within(low: float, high: float) -> Callable[[str], float]:
    return lambda text: _number(text, low, high, f"{low:g} to {high:g}")


def _position(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"expected a position in the list, from 0, found {text!r}")
    return int(text)


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


def one_medium(options: argparse.Namespace) -> Medium:
    """The medium to render into a file."""
    if len(options.media) != 1:
        raise InputError(f"--output renders one medium, found {len(options.media)}; give one")
    medium: Medium = options.media[0]
    return medium

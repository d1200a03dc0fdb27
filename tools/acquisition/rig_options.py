"""Options that select the camera and the projectors; rig.py opens them."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from counterlight.command import Arguments, Parser, parse_seconds, parse_size
from counterlight.tools.choices import MOST_LAG
from counterlight.tools.shipped import parse_scene

MOST_SHOTS = 256
SENSOR = "bits", "full_well", "read_noise"
CAMERAS = "simulated:SCENE|CALIBRATION, folder:DIR, v4l2:NUMBER, pylon:SERIAL|N or gphoto2"


def add_rig_options(parser: Parser, shots: str = "1", curve: str = "the calibration's") -> None:
    """Add --camera and the options around it; `shots` and `curve` are defaults in the help text."""
    _add_devices(parser.add_argument_group("projector and camera"))
    _add_exposure(parser.add_argument_group("exposure"), shots, curve)
    _add_sensor(parser.add_argument_group("simulated camera"))


def _add_devices(group: Arguments) -> None:
    group.add_argument(
        "--camera",
        required=True,
        action="append",
        metavar="CAMERA",
        help=f"photograph with {CAMERAS}; may be repeated",
    )
    group.add_argument(
        "--projector",
        type=parse_size,
        action="append",
        default=[],
        metavar="WxH",
        help="set the projector's size in pixels; may be repeated (default: as the monitor or scene says)",
    )
    where = group.add_mutually_exclusive_group()
    where.add_argument(
        "--monitor",
        action="append",
        default=[],
        metavar="NAME|N",
        help="show the patterns on this monitor; repeat for several projectors, from left to right",
    )
    where.add_argument("--window", action="store_true", help="show the patterns in a window, for trials")
    group.add_argument("--desktop", action="store_true", help="allow the primary monitor to be a projector")
    group.add_argument("--no-preflight", action="store_true", help="do not check the projector and the camera first")


def _add_exposure(group: Arguments, shots: str, curve: str) -> None:
    group.add_argument(
        "--exposures",
        type=_times,
        metavar="T,T…",
        help="set the exposure times of a bracket in seconds, or as factors for a simulated camera (default 1)",
    )
    group.add_argument(
        "--shots",
        type=_shots,
        metavar="N",
        help=f"average N shots of each exposure; noise falls by √N (default: {shots})",
    )
    group.add_argument(
        "--camera-response",
        metavar="linear|srgb|GAMMA|FILE.toml",
        help=f"undo this curve of the camera (default: {curve})",
    )
    group.add_argument(
        "--wait",
        type=parse_seconds,
        default=0.0,
        metavar="SECONDS",
        help="wait this long for files of folder: (default 0)",
    )


def _add_sensor(group: Arguments) -> None:
    group.add_argument(
        "--bits", type=int, metavar="N", help="set the bits of a code value (default: the scene's, or 14)"
    )
    group.add_argument(
        "--full-well",
        type=float,
        metavar="ELECTRONS",
        help="set the electrons of a full pixel; 0: no noise (default: the scene's, or 20000)",
    )
    group.add_argument(
        "--read-noise", type=float, metavar="ELECTRONS", help="set the read noise (default: the scene's, or 5)"
    )
    group.add_argument(
        "--lag", type=int, default=0, metavar="FRAMES", help=f"delay the captures by 0 to {MOST_LAG} frames (default 0)"
    )
    group.add_argument("--seed", type=int, default=0, metavar="N", help="set the seed of the noise (default 0)")


def sources_of(cameras: Sequence[str]) -> list[Path]:
    """Returns the files and folders that cameras read; InputError for a simulated camera without a scene."""
    named = [camera.partition(":") for camera in cameras]
    rooms = [parse_scene(source) for kind, _, source in named if kind == "simulated"]
    return rooms + [Path(source) for kind, _, source in named if kind == "folder"]


def _shots(text: str) -> int:
    if not (text.isdecimal() and 1 <= int(text) <= MOST_SHOTS):
        raise argparse.ArgumentTypeError(f"expected a number of shots from 1 to {MOST_SHOTS}, found {text!r}")
    return int(text)


def _times(text: str) -> tuple[float, ...]:
    from counterlight.tools.acquisition.cameras.camera import Exposures

    try:
        return Exposures(tuple(float(word) for word in text.split(","))).times
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected numbers joined by commas, such as 1,0.1, found {text!r}") from None

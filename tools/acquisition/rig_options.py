"""Options that select the camera and the projectors; rig.py opens them."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from counterlight.command import at_least_0, parse_size
from counterlight.tools.choices import MOST_LAG
from counterlight.tools.shipped import parse_scene

MOST_SHOTS = 256
SENSOR = "bits", "full_well", "read_noise"
CAMERAS = "simulated:SCENE|CALIBRATION, folder:DIR, v4l2:NUMBER, pylon:SERIAL|N or gphoto2"


def add_rig_options(parser: argparse.ArgumentParser, shots: str = "1") -> None:
    """Add --camera and the options around it; `shots` is the default in the help text."""
    parser.add_argument(
        "--camera", required=True, action="append", metavar="CAMERA", help=f"{CAMERAS}; several photograph together"
    )
    parser.add_argument(
        "--projector",
        type=parse_size,
        action="append",
        default=[],
        metavar="WIDTHxHEIGHT",
        help="its pixels (a scene knows them); once for each",
    )
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--monitor",
        action="append",
        default=[],
        metavar="NAME|N",
        help="the projector, filled with the patterns; once for each, from left to right",
    )
    where.add_argument("--window", action="store_true", help="patterns in a plain window, to try things with")
    parser.add_argument("--desktop", action="store_true", help="a projector may be the primary monitor")
    parser.add_argument(
        "--exposures",
        type=_times,
        metavar="T,T…",
        help="of a bracket, seconds (simulated: factors; default 1)",
    )
    parser.add_argument(
        "--shots", type=_shots, metavar="N", help=f"of each exposure, averaged: noise falls by √N (default {shots})"
    )
    parser.add_argument("--camera-response", default="linear", metavar="linear|srgb|GAMMA|FILE.toml")
    parser.add_argument("--no-preflight", action="store_true", help="do not check projector and camera first")
    parser.add_argument(
        "--wait", type=_seconds, default=0.0, metavar="SECONDS", help="folder: for captures (default 0)"
    )
    sensor = parser.add_argument_group("simulated camera")
    sensor.add_argument("--bits", type=int, help="of a code value (default: the scene's, or 14)")
    sensor.add_argument(
        "--full-well", type=float, metavar="ELECTRONS", help="0: no noise (default: the scene's, or 20000)"
    )
    sensor.add_argument("--read-noise", type=float, metavar="N", help="electrons (default: the scene's, or 5)")
    sensor.add_argument("--lag", type=int, default=0, metavar="FRAMES", help=f"0 to {MOST_LAG} (default 0)")
    sensor.add_argument("--seed", type=int, default=0, help="of its noise (default 0)")


def sources_of(cameras: Sequence[str]) -> list[Path]:
    """Returns the files and folders that cameras read; InputError for a simulated camera without a scene."""
    named = [camera.partition(":") for camera in cameras]
    rooms = [parse_scene(source) for kind, _, source in named if kind == "simulated"]
    return rooms + [Path(source) for kind, _, source in named if kind == "folder"]


def _shots(text: str) -> int:
    if not (text.isdecimal() and 1 <= int(text) <= MOST_SHOTS):
        raise argparse.ArgumentTypeError(f"expected a number of shots from 1 to {MOST_SHOTS}, found {text!r}")
    return int(text)


def _seconds(text: str) -> float:
    return at_least_0(text, f"expected a number of seconds, 0 or more, found {text!r}")


def _times(text: str) -> tuple[float, ...]:
    from counterlight.tools.acquisition.cameras.camera import Exposures

    try:
        return Exposures(tuple(float(word) for word in text.split(","))).times
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected numbers joined by commas, such as 1,0.1, found {text!r}") from None

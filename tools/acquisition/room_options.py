"""Options of acquiring and importing: the room's folder, the projector's response, and the factoring of T."""

import argparse
from pathlib import Path

from counterlight.errors import InputError
from counterlight.response import Response, projector_response
from counterlight.tools.choices import MOST_TOLERANCE, TOLERANCE

ASSUMED = Response("srgb")
ASSUMED_LINE = "response: sRGB assumed; measure it with counterlight fit-response, and give it with --response"


def add_room_options(parser: argparse.ArgumentParser, unless_given: str = "sRGB assumed") -> None:
    """Add --response, --name, --force and --output.

    unless_given : what happens without --response, for the help text.
    """
    parser.add_argument(
        "--response",
        metavar="linear|srgb|GAMMA|FILE.toml",
        help=f"the projector's light for a code value (default: {unless_given})",
    )
    parser.add_argument("--name", help="the room's name (default: the folder's)")
    parser.add_argument("--force", action="store_true", help="replace a calibration that is there already")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FOLDER", help="the calibration folder")


def given_or_assumed(text: str | None) -> Response:
    """Returns the response that --response names, or the assumed response; callers then print `ASSUMED_LINE`."""
    return ASSUMED if text is None else projector_response(text)


DENSE = "a dense T becomes near light and factors of far light, what is blurred at many pixels blocks of pixels"


def add_tolerance(parser: argparse.ArgumentParser, what: str = DENSE, default: float = TOLERANCE) -> None:
    """Add --tolerance; `what` describes the effect on T."""
    parser.add_argument(
        "--tolerance",
        type=_parse_tolerance,
        default=default,
        metavar="DB",
        help=f"{what}; what compensated pictures may lose by that, in dB of the camera's picture (default {default:g}; "
        "0: T stays as it is)",
    )


def _parse_tolerance(text: str) -> float:
    """Parse --tolerance; InputError before anything is captured or read."""
    try:
        tolerance = float(text)
    except ValueError:
        tolerance = -1.0
    if not 0 <= tolerance <= MOST_TOLERANCE:
        raise InputError(f"--tolerance {text}: expected 0 (T stays as it is) to {MOST_TOLERANCE:g} dB")
    return tolerance

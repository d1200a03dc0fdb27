"""Options of acquiring and importing: the room's folder, the projector's response, and the factoring of T."""

from pathlib import Path

from counterlight.command import Arguments
from counterlight.errors import InputError
from counterlight.response import Response, projector_response
from counterlight.tools.choices import MOST_TOLERANCE, TOLERANCE

ASSUMED = Response("srgb")
ASSUMED_LINE = "response: sRGB assumed; measure it with counterlight fit-response, and give it with --response"


def add_room_options(parser: Arguments, unless_given: str = "srgb, assumed") -> None:
    """Add --response, --name, --force and --output.

    unless_given : the response without --response, for the help text.
    """
    parser.add_argument(
        "--response",
        metavar="linear|srgb|GAMMA|FILE.toml",
        help=f"use this response of the projector (default: {unless_given})",
    )
    parser.add_argument("--name", help="name the room (default: as the folder)")
    parser.add_argument("--force", action="store_true", help="replace an existing calibration")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FOLDER", help="write the calibration here")


def given_or_assumed(text: str | None) -> Response:
    """Returns the response that --response names, or the assumed response; callers then print `ASSUMED_LINE`."""
    return ASSUMED if text is None else projector_response(text)


DENSE = "factor far light and strong blur"


def add_tolerance(parser: Arguments, what: str = DENSE, default: float = TOLERANCE) -> None:
    """Add --tolerance; `what` names the effect on T in the help text."""
    parser.add_argument(
        "--tolerance",
        type=_parse_tolerance,
        default=default,
        metavar="DB",
        help=f"{what} if compensated pictures lose at most this (0: never; default {default:g})",
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

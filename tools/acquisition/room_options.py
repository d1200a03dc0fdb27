"""What the importing commands share: where the room goes, how its projector responds, and what of T may be factors."""

import argparse
from pathlib import Path

from counterlight.errors import InputError
from counterlight.tools.choices import MOST_TOLERANCE, TOLERANCE


def add_room_options(parser: argparse.ArgumentParser) -> None:
    """--response, --name, --force and --output."""
    parser.add_argument(
        "--response",
        default="linear",
        metavar="linear|srgb|GAMMA|FILE.toml",
        help="the projector's light for a code value (default linear)",
    )
    parser.add_argument("--name", help="the room's name (default: the folder's)")
    parser.add_argument("--force", action="store_true", help="replace a calibration that is there already")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FOLDER", help="the calibration folder")


def add_tolerance(parser: argparse.ArgumentParser) -> None:
    """--tolerance."""
    parser.add_argument(
        "--tolerance",
        type=_parse_tolerance,
        default=TOLERANCE,
        metavar="DB",
        help="a dense T becomes near light and factors of far light; what compensated pictures may lose by that, in dB "
        f"of the camera's picture (default {TOLERANCE:g}; 0: T stays as it is)",
    )


def _parse_tolerance(text: str) -> float:
    """Refused before anything is captured or read."""
    try:
        tolerance = float(text)
    except ValueError:
        tolerance = -1.0
    if not 0 <= tolerance <= MOST_TOLERANCE:
        raise InputError(f"--tolerance {text}: expected 0 (T stays as it is) to {MOST_TOLERANCE:g} dB")
    return tolerance

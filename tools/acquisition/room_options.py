"""What the importing commands share: where the room goes, and a response as it is named on a command line."""

import argparse
from pathlib import Path

from counterlight.errors import InputError
from counterlight.reading import read_toml
from counterlight.response import Response, parse_response

FIX = "a response file holds: response = [[0, 0, 0], …, [1, 1, 1]], as in a calibration.toml"


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


def named_response(text: str) -> Response:
    """`linear`, `srgb`, a gamma such as `2.2`, or a .toml file with `response = …`; InputError for anything else."""
    if not text.endswith(".toml"):
        return parse_response(text)
    path = Path(text)
    table = read_toml(path, FIX)
    if "response" not in table:
        raise InputError(f"{path}: has no entry named response; {FIX}")
    try:
        return parse_response(table["response"])
    except InputError as error:
        raise InputError(f"{path}: {error}") from None

"""What the importing commands share: where the room goes, and how its projector responds."""

import argparse
from pathlib import Path


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

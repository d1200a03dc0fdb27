"""The option --colour, shared by every command that judges or changes colours."""

import argparse

from counterlight.tools.choices import COLOURS


def add_colour(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--colour",
        choices=COLOURS,
        default="auto",
        help="which projector primaries a camera channel sees: its own (independent), a mixing that is one for "
        "the whole room (global), or of each camera pixel (pixel); default auto: the least that explains the "
        "floodlights of the primaries",
    )

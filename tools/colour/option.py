"""The option --colour, shared by every command that judges or changes colours."""

from counterlight.command import Arguments
from counterlight.tools.choices import COLOURS


def add_colour(parser: Arguments) -> None:
    parser.add_argument(
        "--colour",
        choices=COLOURS,
        default="auto",
        help="choose the primaries that a camera channel sees: its own (independent), one mixture for the room "
        "(global), or one per camera pixel (pixel); auto: the simplest that explains the floodlights (default auto)",
    )

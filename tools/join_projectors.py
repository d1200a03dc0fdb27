"""counterlight join: join calibrations of several projectors, of several cameras, or of several views of one room.

By default, rooms are joined as projectors that one camera saw. --cameras joins them as cameras that saw the same
projectors. This is also the default for rooms with the same projectors whose cameras differ in size, or whose monitors
have the same names. --at joins rooms as views, for viewers that move.
"""

import argparse
import math
from collections.abc import Sequence
from pathlib import Path

from counterlight.command import Parser, command_line, conclusion, verb
from counterlight.errors import InputError
from counterlight.tools.acquisition.room_options import add_tolerance
from counterlight.tools.choices import SCREENS
from counterlight.viewpoints import FARTHEST, Places

EXAMPLES = (
    "counterlight join left right -o both",
    "counterlight join left right --at 0 --at 1 -o views",
)


@verb
def main(argv: Sequence[str] | None) -> None:
    options = _parser().parse_args(argv)
    print(_joined(options))
    print(conclusion(f"{options.output}: joined", command_line("build", options.output)))


def _joined(options: argparse.Namespace) -> str:
    """Joins the rooms as views, cameras or projectors; returns a description."""
    from counterlight.tools.joining.cameras import CameraOptions, join_cameras, same_projectors
    from counterlight.tools.joining.projectors import join_rooms

    named = {"name": options.name, "force": options.force}
    if options.at:
        if options.cameras:
            raise InputError(
                "--cameras makes one room of all, --at a set of views for viewers that move; leave one out"
            )
        from counterlight.tools.joining.views import join_views

        asked = CameraOptions(options.screen, options.keep_exposures, options.tolerance)
        return join_views(options.rooms, Places(tuple(options.at)), options.output, asked, options.monitor, **named)
    if options.cameras or same_projectors(options.rooms):
        asked = CameraOptions(options.screen, options.keep_exposures, options.tolerance)
        if not options.cameras:
            print("taken for several cameras of the same projectors")
        return join_cameras(options.rooms, options.output, asked, options.monitor, **named)
    if options.keep_exposures or options.screen != SCREENS[0]:
        raise InputError("--screen and --keep-exposures are for cameras: add --cameras, or leave them out")
    return join_rooms(options.rooms, options.output, options.monitor, tolerance=options.tolerance, **named)


def _place(text: str) -> tuple[float, float]:
    found = text.split(",")
    try:
        x, y = (*map(float, found), 0.0)[:2]
    except ValueError:
        x = y = math.nan
    if len(found) > 2 or not max(abs(x), abs(y)) <= FARTHEST:
        raise argparse.ArgumentTypeError(f"expected X or X,Y, found {text!r}")
    return x, y


def _parser() -> argparse.ArgumentParser:
    parser = Parser("join", description=__doc__, examples=EXAMPLES)
    parser.add_argument("rooms", type=Path, nargs="+", metavar="ROOM", help="calibration folders, from left to right")
    parser.add_argument(
        "-o", "--output", type=Path, required=True, metavar="FOLDER", help="write the joint calibration here"
    )
    parser.add_argument(
        "--monitor",
        action="append",
        default=[],
        metavar="NAME",
        help="name the monitor of each projector, in their order (counterlight play --list-monitors); may be repeated",
    )
    parser.add_argument(
        "--cameras", action="store_true", help="join rooms that show the same projectors to several cameras"
    )
    parser.add_argument(
        "--at",
        type=_place,
        action="append",
        default=[],
        metavar="X[,Y]",
        help="join rooms that are views of one room, and place each view, in their order and in any unit; may be "
        "repeated (see counterlight play --viewpoint)",
    )
    parser.add_argument(
        "--screen",
        choices=SCREENS,
        default=SCREENS[0],
        help="combine cameras in the view of the first camera, or of the first projector, which needs no overlap "
        "(default camera)",
    )
    parser.add_argument(
        "--keep-exposures", action="store_true", help="do not match the cameras' brightness where they overlap"
    )
    add_tolerance(parser)
    parser.add_argument("--name", help="name the room (default: as the folder)")
    parser.add_argument("--force", action="store_true", help="replace an existing calibration")
    return parser

"""counterlight join: one calibration of several projectors, from calibrations of each with the same camera."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from counterlight.command import Parser, run
from counterlight.tools.acquisition.room_options import add_tolerance


def main(argv: Sequence[str] | None = None) -> int:
    return run(_main, argv)


def _main(argv: Sequence[str] | None) -> None:
    options = _parser().parse_args(argv)
    from counterlight.tools.transport.joining import join_rooms

    line = join_rooms(
        options.rooms,
        options.output,
        options.monitor,
        name=options.name,
        force=options.force,
        tolerance=options.tolerance,
    )
    print(line)


def _parser() -> argparse.ArgumentParser:
    parser = Parser("join", description=__doc__)
    parser.add_argument("rooms", type=Path, nargs="+", metavar="ROOM", help="calibration folders, from left to right")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FOLDER", help="the joint calibration")
    parser.add_argument(
        "--monitor",
        action="append",
        default=[],
        metavar="NAME",
        help="the monitor that a projector is, once for each in their order (counterlight play --list-monitors)",
    )
    add_tolerance(parser)
    parser.add_argument("--name", help="what to call it (default: the folder's name)")
    parser.add_argument("--force", action="store_true", help="replace a calibration that is there already")
    return parser


if __name__ == "__main__":
    sys.exit(main())

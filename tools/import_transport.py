"""counterlight import-transport: a calibration folder from light transport matrices that somebody else measured."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from counterlight.command import Parser, parse_size, run
from counterlight.tools.acquisition.room_options import ASSUMED_LINE, add_room_options, add_tolerance, given_or_assumed

READ = "--camera and --projector are WIDTHxHEIGHT, and pixels are numbered row by row; import T again if that is wrong"


def main(argv: Sequence[str] | None = None) -> int:
    return run(_main, argv)


def _main(argv: Sequence[str] | None) -> None:
    options = _parser().parse_args(argv)
    from counterlight.calibration import Device
    from counterlight.response import Response
    from counterlight.tools.acquisition.matrices_room import MatrixFiles, import_matrices_room

    (height, width), (camera_height, camera_width) = options.projector, options.camera
    summary = import_matrices_room(
        MatrixFiles((options.red, options.green, options.blue), options.ambient, options.mask),
        options.output,
        Device(height, width, given_or_assumed(options.response)),
        Device(camera_height, camera_width, Response("linear")),
        name=options.name,
        force=options.force,
        tolerance=options.tolerance,
    )
    print(f"{options.output}: {summary}")
    if summary.misreading is not None:
        described = summary.misreading.described(lambda size: f"{size[1]}x{size[0]}")
        print(f"warning: {described}; {READ}", file=sys.stderr)
    if options.response is None:
        print(ASSUMED_LINE)


def _parser() -> argparse.ArgumentParser:
    parser = Parser("import-transport", description=__doc__)
    for channel in ("red", "green", "blue"):
        parser.add_argument(
            f"--{channel}",
            type=Path,
            required=True,
            metavar="FILE.npz",
            help=f"T of the {channel} channel: scipy.sparse.save_npz, camera pixels x projector pixels",
        )
    parser.add_argument("--camera", type=parse_size, required=True, metavar="WIDTHxHEIGHT")
    parser.add_argument("--projector", type=parse_size, required=True, metavar="WIDTHxHEIGHT")
    parser.add_argument(
        "--ambient", type=Path, metavar="FILE", help="camera picture with a black projector, .exr or .npy (default 0)"
    )
    parser.add_argument(
        "--mask", type=Path, metavar="FILE.png", help="white where a camera pixel counts (default: the lit pixels)"
    )
    add_tolerance(parser)
    add_room_options(parser)
    return parser


if __name__ == "__main__":
    sys.exit(main())

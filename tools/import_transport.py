"""counterlight import-transport: make a calibration from light transport matrices that were measured elsewhere."""

import sys
from collections.abc import Sequence
from pathlib import Path

from counterlight.command import Parser, command_line, conclusion, parse_size, verb
from counterlight.tools.acquisition.room_options import ASSUMED_LINE, add_room_options, add_tolerance, given_or_assumed

READ = "--camera and --projector are WIDTHxHEIGHT, and pixels are numbered row by row; import T again if that is wrong"

MATRICES = (
    "counterlight import-transport --red r.npz --green g.npz --blue b.npz \\\n      --camera 64x48 --projector 48x36"
)
EXAMPLES = f"{MATRICES} -o room", f"{MATRICES} --ambient black.exr --force -o room"


@verb
def main(argv: Sequence[str] | None) -> None:
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
    for doubt in summary.doubts:
        print(f"warning: {doubt}", file=sys.stderr)
    if summary.misreading is not None:
        described = summary.misreading.described(lambda size: f"{size[1]}x{size[0]}")
        print(f"warning: {described}; {READ}", file=sys.stderr)
    if options.response is None:
        print(ASSUMED_LINE)
    print(conclusion(f"{options.output}: imported", command_line("build", options.output)))


def _parser() -> Parser:
    parser = Parser("import-transport", description=__doc__, examples=EXAMPLES)
    for channel in ("red", "green", "blue"):
        parser.add_argument(
            f"--{channel}",
            type=Path,
            required=True,
            metavar="FILE.npz",
            help=f"read T of the {channel} channel: scipy.sparse.save_npz, camera pixels x projector pixels",
        )
    for device in ("camera", "projector"):
        parser.add_argument(
            f"--{device}", type=parse_size, required=True, metavar="WxH", help=f"state the {device}'s size in pixels"
        )
    parser.add_argument(
        "--ambient",
        type=Path,
        metavar="FILE",
        help="read the camera picture of a black projector, .exr or .npy (default 0)",
    )
    parser.add_argument(
        "--mask",
        type=Path,
        metavar="FILE.png",
        help="count only camera pixels that are white here (default: lit pixels)",
    )
    add_tolerance(parser)
    add_room_options(parser)
    return parser

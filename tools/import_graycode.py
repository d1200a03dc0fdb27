"""counterlight import-graycode: make a calibration from photographs of Gray-code patterns, by direct mapping."""

import time
from collections.abc import Sequence
from pathlib import Path

from counterlight.command import Parser, command_line, conclusion, parse_size, verb
from counterlight.response import named_response
from counterlight.tools.acquisition.room_options import ASSUMED_LINE, add_room_options, given_or_assumed
from counterlight.tools.choices import GRAYCODE_ORDERS

EXAMPLES = (
    "counterlight import-graycode captures --projector 1024x768 -o room",
    "counterlight import-graycode captures --projector 1024x768 --step 2 -o room",
)


@verb
def main(argv: Sequence[str] | None) -> None:
    options = _parser().parse_args(argv)
    from counterlight.calibration import Device
    from counterlight.tools.acquisition.graycode_room import GraycodeOptions, import_graycode_room

    start = time.monotonic()
    height, width = options.projector
    graycode_options = GraycodeOptions(
        Device(height, width, given_or_assumed(options.response)),
        named_response(options.camera_response),
        options.order,
        options.step,
        options.min_contrast,
        options.fill_radius,
    )
    summary = import_graycode_room(
        options.captures, options.output, graycode_options, name=options.name, force=options.force
    )
    print(f"{options.output}: {summary}, {time.monotonic() - start:.1f} s")
    if options.response is None:
        print(ASSUMED_LINE)
    print(conclusion(f"{options.output}: imported", command_line("build", options.output)))


def _parser() -> Parser:
    parser = Parser("import-graycode", description=__doc__, examples=EXAMPLES)
    parser.add_argument("captures", type=Path, help="folder of the captures, PNG or JPEG")
    parser.add_argument(
        "--projector", type=parse_size, required=True, metavar="WxH", help="state the projector's size in pixels"
    )
    parser.add_argument(
        "--order",
        choices=GRAYCODE_ORDERS,
        help="state the order of the captures. opencv: sorted names for columns, rows, white and black, each bit "
        "followed by its inverse. sltk: names such as 04_x_bit08_pos (default: found from the names)",
    )
    parser.add_argument(
        "--step",
        type=int,
        default=1,
        metavar="PIXELS",
        help="state the side of a code cell in projector pixels (default 1)",
    )
    parser.add_argument(
        "--min-contrast",
        type=float,
        default=5.0,
        metavar="CODES",
        help="ignore camera pixels where a pattern and its inverse differ by less, in 8-bit code values (default 5)",
    )
    parser.add_argument(
        "--fill-radius",
        type=int,
        default=4,
        metavar="CELLS",
        help="fill gaps of up to twice this width between decoded projector pixels; 0: fill none (default 4)",
    )
    parser.add_argument(
        "--camera-response",
        default="linear",
        metavar="linear|srgb|GAMMA|FILE.toml",
        help="undo this curve of the camera (default linear)",
    )
    add_room_options(parser)
    return parser

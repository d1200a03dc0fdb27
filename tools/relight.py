"""counterlight relight: compute how a room looks under a picture, from the camera or from the projector's place."""

import argparse
import math
from collections.abc import Sequence
from pathlib import Path

from counterlight.command import Parser, command_line, conclusion, verb
from counterlight.tools.choices import RELIT_VIEWS
from counterlight.tools.shared_options import add_colour

MEANING = """views:
  camera          T p + e, the room under a projector picture
  dual            Tᵀ c', the scene from the projector's place, lit by the camera
  inverse-camera  column sums of T⁺, in the camera's view
  inverse-dual    T⁺ c', the projector picture that makes the camera see c'

The inverse views need a correction map."""

SHOWN = {
    "camera": "the room as the camera sees it",
    "dual": "the room from the projector's place, lit by the camera",
    "inverse-camera": "how much each camera pixel asks of the projector",
    "inverse-dual": "the projector picture for this camera picture",
}

EXAMPLES = (
    "counterlight relight room picture.png -o seen.png",
    "counterlight relight room picture.png --view inverse-dual -o drive.png",
)


@verb
def main(argv: Sequence[str] | None) -> None:
    options = _parser().parse_args(argv)
    from counterlight.calibration import check_order
    from counterlight.tools.relighting.relight import RelightOptions, relight

    check_order(options.calibration, [options.picture])
    wanted = RelightOptions(options.view, options.ambient, options.white, options.colour)
    print(relight(options.calibration, options.picture, options.output, wanted))
    print(conclusion(f"{options.output}: {SHOWN[options.view]}", _next(options)))


def _next(options: argparse.Namespace) -> str:
    room, output = options.calibration, options.output
    match options.view:
        case "camera":
            return command_line("compensate", room, options.picture or "PICTURE", "-o", "FILE")
        case "inverse-dual":
            return command_line("relight", room, output, "-o", "FILE")
        case _:
            return command_line("play", room, "MEDIA")


def _parser() -> argparse.ArgumentParser:
    parser = Parser("relight", description=f"{__doc__}\n\n{MEANING}", examples=EXAMPLES)
    parser.add_argument("calibration", type=Path, help="calibration folder")
    parser.add_argument(
        "picture",
        type=Path,
        nargs="?",
        help="projector picture (camera views) or camera picture (dual views), fitted into the frame; .exr is linear, "
        "pixel by pixel (default: white)",
    )
    parser.add_argument("--view", choices=RELIT_VIEWS, default="camera", help="choose the view (default camera)")
    parser.add_argument(
        "-o", "--output", type=Path, required=True, metavar="FILE", help="write the view: .png (sRGB) or .exr (linear)"
    )
    parser.add_argument(
        "--ambient",
        action=argparse.BooleanOptionalAction,
        help="include the ambient light in the view camera (default yes)",
    )
    parser.add_argument(
        "--white",
        type=_level,
        metavar="LEVEL",
        help="show this linear value as white in a PNG (default: the 99th percentile)",
    )
    add_colour(parser)
    return parser


def _level(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not (math.isfinite(value) and value > 0):
        raise argparse.ArgumentTypeError(f"expected a level above 0, found {text!r}")
    return value

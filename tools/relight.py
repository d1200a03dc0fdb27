"""relight: what a measured room looks like under a picture, from the camera or from the projector's place."""

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path

from counterlight.command import Parser, run
from counterlight.tools.choices import RELIT_VIEWS
from counterlight.tools.colour.option import add_colour

MEANING = """camera: T p + e, the room under a projector picture; dual: Tᵀ c', the scene from the projector's
place, lit by the camera; inverse-camera: the column sums of T⁺ in camera space; inverse-dual: T⁺ c', what the projector
must show for the camera to see c'. Without PICTURE it is white. The inverse views need a correction map."""


def main(argv: Sequence[str] | None = None) -> int:
    return run(_main, argv)


def _main(argv: Sequence[str] | None) -> None:
    options = _parser().parse_args(argv)
    from counterlight.calibration import check_order
    from counterlight.tools.relighting.relight import RelightOptions, relight

    check_order(options.calibration, [options.picture])
    wanted = RelightOptions(options.view, options.ambient, options.white, options.colour)
    print(relight(options.calibration, options.picture, options.output, wanted))


def _parser() -> argparse.ArgumentParser:
    parser = Parser("relight", description=__doc__, epilog=MEANING)
    parser.add_argument("calibration", type=Path, help="a calibration folder")
    parser.add_argument(
        "picture",
        type=Path,
        nargs="?",
        help="projector picture (camera views) or camera picture (dual views), fitted into the frame; .exr is linear, "
        "pixel by pixel (default: white)",
    )
    parser.add_argument("--view", choices=RELIT_VIEWS, default="camera", help="what to show (default camera)")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FILE", help=".png (sRGB) or .exr (linear)")
    parser.add_argument(
        "--ambient", action=argparse.BooleanOptionalAction, help="with ambient light (camera view; default: yes)"
    )
    parser.add_argument(
        "--white",
        type=_level,
        metavar="LEVEL",
        help="the linear value that a PNG shows as white (default: the picture's 99th percentile)",
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


if __name__ == "__main__":
    sys.exit(main())

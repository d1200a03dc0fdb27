"""The options of what is minimised, which several commands share (tools/transport/objective.py)."""

import argparse

from counterlight.tools.choices import OUTSIDE


def add_objective_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--outside",
        choices=OUTSIDE,
        default=OUTSIDE[0],
        help="what projector pixels show that the camera does not see: nothing (default), or a smooth continuation",
    )
    parser.add_argument(
        "--drift",
        type=float,
        default=0.1,
        metavar="PIXELS",
        help="how far the projector's picture may shift, in its pixels: neighbours then differ less (default 0.1)",
    )

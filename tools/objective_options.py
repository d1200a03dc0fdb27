"""Options of the objective that the solvers minimise, shared by several commands (tools/transport/objective.py)."""

import argparse
from typing import TYPE_CHECKING

from counterlight.tools.choices import OUTSIDE

if TYPE_CHECKING:
    from counterlight.tools.transport.objective import ObjectiveOptions


def aims_of(options: argparse.Namespace) -> "ObjectiveOptions":
    from counterlight.tools.transport.objective import ObjectiveOptions

    return ObjectiveOptions(options.drift, options.outside, options.avoid_highlights)


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
        default=0.05,
        metavar="PIXELS",
        help="how far the projector's picture may shift, in its pixels: neighbours then differ less (default 0.05)",
    )
    parser.add_argument(
        "--avoid-highlights",
        action="store_true",
        help="of several projectors: where the camera sees one's light by gloss, let another give it: who "
        "stands elsewhere sees a dark spot there otherwise",
    )

"""Options of the objective that the solvers minimise, shared by several commands (tools/transport/objective.py)."""

import argparse
from typing import TYPE_CHECKING

from counterlight.command import Arguments
from counterlight.tools.choices import OUTSIDE

if TYPE_CHECKING:
    from counterlight.tools.transport.objective import ObjectiveOptions


def aims_of(options: argparse.Namespace) -> "ObjectiveOptions":
    from counterlight.tools.transport.objective import ObjectiveOptions

    return ObjectiveOptions(options.drift, options.outside, options.avoid_highlights)


def add_objective_options(parser: Arguments) -> None:
    parser.add_argument(
        "--outside",
        choices=OUTSIDE,
        default=OUTSIDE[0],
        help="show black or a smooth continuation outside the camera's view (default black)",
    )
    parser.add_argument(
        "--drift",
        type=float,
        default=0.05,
        metavar="PIXELS",
        help="tolerate a shift of the projector picture by this much; larger values give smoother pictures (default "
        "0.05)",
    )
    parser.add_argument(
        "--avoid-highlights",
        action="store_true",
        help="with several projectors: light a glossy spot from a projector whose highlight the camera does not see",
    )

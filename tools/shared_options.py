"""Options that several commands share: --colour, the objective that the solvers minimise, and --cluster."""

import argparse
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from counterlight.command import Arguments
from counterlight.jobs.workers import Workers
from counterlight.tools.choices import COLOURS, OUTSIDE

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
        help="outside the camera's view, show black except for pixels whose bounced light the camera sees, dark "
        "everywhere, or a smooth continuation (default black)",
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


def add_cluster(parser: Arguments, what: str) -> None:
    """Add --cluster; `what` names the shared work in the help text, such as `trace the scene`."""
    parser.add_argument(
        "--cluster",
        metavar="ADDRESS",
        help=f"{what} on the dask scheduler at HOST:PORT, or in N local processes with local:N (extra cluster, "
        "docs/size.md; default: in this process)",
    )


@contextmanager
def workers_of(address: str | None, files: Sequence[Path], shared: Path | None) -> Iterator[Workers | None]:
    """Open the workers; None if the work stays in this process.

    files : files that all workers must be able to read.
    shared : folder for results that all workers must see, if any.
    """
    if address is None:
        yield None
        return
    from counterlight.jobs.cluster import open_cluster  # dask.distributed takes a second

    with open_cluster(address, files, shared) as workers:
        yield workers


def add_colour(parser: Arguments) -> None:
    parser.add_argument(
        "--colour",
        choices=COLOURS,
        default="auto",
        help="choose the primaries that a camera channel sees: its own (independent), one mixture for the room "
        "(global), or one per camera pixel (pixel); auto: the simplest that explains the floodlights (default auto)",
    )

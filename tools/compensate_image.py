"""counterlight compensate: one picture by a CPU solver, and what the camera sees; the player's reference."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from counterlight.command import Parser, run
from counterlight.tools.choices import COMPENSATIONS
from counterlight.tools.colour.option import add_colour
from counterlight.tools.objective_options import add_objective_options, aims_of

MEANING = """none: uncorrected; direct: one camera pixel per projector pixel; triangulated: between three of them; map:
the correction map, as the player applies it; qr, svd: least squares per cluster; nnls: non-negative; box: the best that
a projector can show (0 to 1). All are clamped to 0..1 and judged through the undecomposed transport, over the lit
camera pixels."""


def main(argv: Sequence[str] | None = None) -> int:
    return run(_main, argv)


def _main(argv: Sequence[str] | None) -> None:
    options = _parser().parse_args(argv)
    from counterlight.calibration import check_order
    from counterlight.tools.solve.compensate import CompensateOptions, compensate
    from counterlight.tools.transport.objective import DEFAULT_AIMS

    names = COMPENSATIONS if options.solver == "all" else tuple(options.solver.split(","))
    check_order(options.calibration, [options.picture])
    aims, solvers = aims_of(options), tuple(dict.fromkeys(names))
    priors = options.priors or aims != DEFAULT_AIMS
    wanted = CompensateOptions(solvers, options.max_cluster, options.white, options.colour, aims, priors)
    for line in compensate(options.calibration, options.picture, options.output, wanted):
        print(line, flush=True)


def _parser() -> argparse.ArgumentParser:
    parser = Parser("compensate", description=__doc__, epilog=MEANING)
    parser.add_argument("calibration", type=Path, help="a calibration folder")
    parser.add_argument(
        "picture", type=Path, help="what the camera is to see, fitted into its frame; .exr is radiance, pixel by pixel"
    )
    parser.add_argument(
        "--solver",
        default="box",
        metavar="NAME[,NAME…]",
        help=f"all, or some of {', '.join(COMPENSATIONS)} (default box)",
    )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="FILE",
        help=".png (the projector's code values) or .exr (linear drive); with several solvers FILE-solver.png",
    )
    parser.add_argument(
        "--max-cluster",
        type=int,
        metavar="N",
        help="for qr, svd and nnls: decompose T into clusters of up to N pixels",
    )
    parser.add_argument("--white", type=float, metavar="RADIANCE", help="of a white picture (default: as the player)")
    add_colour(parser)
    parser.add_argument(
        "--priors",
        action="store_true",
        help="box seeks what play seeks, with weights and priors, instead of least squares alone; the next three "
        "options ask for it, too",
    )
    add_objective_options(parser)
    return parser


if __name__ == "__main__":
    sys.exit(main())

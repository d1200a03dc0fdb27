"""counterlight compensate: compute a projector picture by solvers on the processor, and predict the camera picture."""

from collections.abc import Sequence
from pathlib import Path

from counterlight.command import Parser, add_verbose, command_line, conclusion, verb
from counterlight.tools.choices import COMPENSATIONS
from counterlight.tools.shared_options import add_colour, add_objective_options, aims_of

MEANING = """solvers:
  none          no compensation
  direct        one camera pixel per projector pixel
  triangulated  interpolation between three camera pixels
  map           the correction map, as the player applies it
  qr, svd       least squares per cluster
  nnls          least squares per cluster, drive not negative
  box           least squares with drive from 0 to 1, the best that a projector can show

All results are clamped to 0..1, and judged by the whole transport over the lit camera pixels."""

EXAMPLES = (
    "counterlight compensate room picture.png -o projector.png",
    "counterlight compensate room picture.png --solver all",
)
COMMON = "--solver", "--output", "--white", "--verbose"


@verb
def main(argv: Sequence[str] | None) -> None:
    options = _parser().parse_args(argv)
    from counterlight.calibration import check_order
    from counterlight.tools.solve.compensate import CompensateOptions, compensate
    from counterlight.tools.transport.objective import DEFAULT_AIMS

    names = COMPENSATIONS if options.solver == "all" else tuple(options.solver.split(","))
    check_order(options.calibration, [options.picture])
    aims, solvers = aims_of(options), tuple(dict.fromkeys(names))
    priors = options.priors or aims != DEFAULT_AIMS
    wanted = CompensateOptions(solvers, options.max_cluster, options.white, options.colour, aims, priors)
    for line in compensate(options.calibration, options.picture, options.output, wanted, verbose=options.verbose):
        print(line, flush=True)
    again = "compensate", options.calibration, options.picture, "-o", "FILE"
    shown = "verify", options.calibration, options.picture, "--camera", "CAMERA"
    action = command_line(*(again if options.output is None else shown))
    print(conclusion(f"{options.picture}: compensated by {', '.join(solvers)}", action))


def _parser() -> Parser:
    parser = Parser("compensate", description=f"{__doc__}\n\n{MEANING}", examples=EXAMPLES, common=COMMON)
    parser.add_argument("calibration", type=Path, help="calibration folder")
    parser.add_argument(
        "picture",
        type=Path,
        help="target picture, fitted into the camera's view; .exr: camera radiance, pixel by pixel",
    )
    add = parser.add_argument
    add(
        "--solver",
        default="box",
        metavar="NAME[,NAME…]",
        help=f"compute the projector picture by these solvers: all, or {', '.join(COMPENSATIONS)} (default box)",
    )
    add(
        "-o",
        "--output",
        type=Path,
        metavar="FILE",
        help="write the projector picture: .png (code values) or .exr (linear drive); several solvers write "
        "FILE-solver.png",
    )
    add("--white", type=float, metavar="RADIANCE", help="set the radiance of a white picture (default: the player's)")
    add(
        "--max-cluster",
        type=int,
        metavar="N",
        help="for qr, svd and nnls: cut T into clusters of at most N pixels (default: do not cut)",
    )
    add_verbose(parser, "steps, gaps and clusters of every solver")
    add_colour(parser)
    objective = parser.add_argument_group("objective of box")
    objective.add_argument(
        "--priors",
        action="store_true",
        help="minimise what the player minimises, with weights and priors, instead of plain least squares; implied by "
        "the next three options",
    )
    add_objective_options(objective)
    return parser

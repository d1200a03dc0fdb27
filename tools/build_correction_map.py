"""counterlight build: invert a calibration's light transport and pack it for the player."""

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from counterlight.command import Arguments, Parser, add_verbose, command_line, conclusion, tell, verb
from counterlight.errors import InputError
from counterlight.tools.choices import INVERSES
from counterlight.tools.shared_options import add_cluster, add_colour, add_objective_options, aims_of, workers_of
from counterlight.viewpoints import calibrations_in, is_set
from counterlight.writing.outputs import check_folder

if TYPE_CHECKING:
    from counterlight.tools.inverse.build import BuiltRoom
    from counterlight.tools.inverse.near_light import InverseOptions
    from counterlight.tools.transport.objective import ObjectiveOptions

EXAMPLES = "counterlight build room", "counterlight build room --inverse whole --report room.build"
COMMON = "--inverse", "--regularize", "--max-error", "--colour", "--outside", "--drift", "--report", "--verbose"


@verb
def main(argv: Sequence[str] | None) -> None:
    options = _parser().parse_args(argv)
    from counterlight.tools.clusters.decomposition import Parameters
    from counterlight.tools.inverse.near_light import InverseOptions
    from counterlight.tools.report.report import check_report_folder

    start = time.monotonic()
    inverse_options = InverseOptions(
        options.regularize,
        options.max_error,
        options.max_cluster,
        options.noise,
        options.inverse,
        None if options.cut is None else Parameters(*options.cut),
        options.tau,
    )
    if options.report is not None:
        check_folder(options.report, inputs=[options.calibration])
        check_report_folder(options.report)
    aims, folders = aims_of(options), calibrations_in(options.calibration)
    if options.report is not None and is_set(options.calibration):
        raise InputError(f"--report {options.report}: is of one view; build it by itself, as {folders[0]}")
    for number, folder in enumerate(folders, 1):
        if is_set(options.calibration):
            print(f"view {number} of {len(folders)}")
        _build(folder, options, inverse_options, aims)
    took = time.monotonic() - start
    result = f"{options.calibration}: ready to play, built in {took:.1f} s"
    print(conclusion(result, command_line("play", options.calibration, "MEDIA")))


def _build(
    folder: Path, options: argparse.Namespace, inverse_options: "InverseOptions", aims: "ObjectiveOptions"
) -> None:
    """Build one calibration and print the results."""
    from counterlight import calibration
    from counterlight.tools.inverse.build import build_room_maps
    from counterlight.tools.report.report import write_report

    stored = calibration.read(folder)
    with workers_of(options.cluster, [stored.folder / calibration.TOML], stored.folder) as workers:
        built = build_room_maps(
            stored, inverse_options, aims, refine=not options.no_refine, colour=options.colour, workers=workers
        )
    print(built.tier)
    if options.verbose:
        print(built.summary)
    print(f"maps: {built.conclusion}")
    if built.coarseness is not None:
        tell(built.coarseness)
    _print_rates(built)
    if options.report is not None:
        print(f"report: {write_report(built, options.report)}")


def _print_rates(built: "BuiltRoom") -> None:
    """Print the frame rate on this machine, with the default steps and with the fewest steps."""
    from counterlight.pipeline.room import Room, start_of
    from counterlight.tools.frame_rate import frames_per_second

    sys.stdout.flush()  # the renderer's lines do not pass through Python's buffer
    found, maps = built.recommendation, built.maps
    steps = [0] if found is None else [found.steps, *([found.clean_steps] if found.clean_steps < found.steps else [])]
    rates = frames_per_second(Room(built.calibration, maps, maps.white, start=start_of(maps)), steps)
    for count, rate, what in zip(steps, rates, ("", ", the fewest for a clean picture"), strict=False):
        print(f"play draws {rate:.{1 if rate < 10 else 0}f} frames per second here with {count} steps{what}")


def _damping(text: str) -> float | None:
    if text in ("auto", "none"):
        return None if text == "auto" else 0.0
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected auto, none or a number from 0 to 1, found {text!r}") from None


def _parser() -> Parser:
    parser = Parser("build", description=__doc__, examples=EXAMPLES, common=COMMON)
    parser.add_argument("calibration", type=Path, help="calibration folder; the maps are written into it")
    _add_inverse(parser.add_argument_group("inverse"))
    objective = parser.add_argument_group("objective")
    add_colour(objective)
    add_objective_options(objective)
    _add_output(parser.add_argument_group("output"))
    _add_cut(parser.add_argument_group("clusters of --inverse cut and thesis"))
    return parser


def _add_inverse(group: Arguments) -> None:
    group.add_argument(
        "--inverse",
        choices=INVERSES,
        default="auto",
        help="whole: invert T as it is; cut: invert T cut into clusters; none: map directly, without an inverse; "
        "thesis: chapter 5 to the letter, for play --refine 0; auto: whole within a minute and half of the memory, "
        "otherwise cut or none (default auto)",
    )
    group.add_argument(
        "--regularize",
        type=_damping,
        default=None,
        metavar="auto|none|NUMBER",
        help="damp the inverse by this fraction of the largest singular value; none: do not damp; auto: the "
        "fraction with the least camera error (default auto)",
    )
    group.add_argument(
        "--max-error",
        type=float,
        default=0.5,
        metavar="CODES",
        help="drop entries that change a pixel by at most this many 8-bit code values; 0: keep all (default 0.5)",
    )
    group.add_argument(
        "--noise",
        type=float,
        default=0.0,
        metavar="SHARE",
        help="state the relative noise of T, such as 0.01; singular values that can be noise are dropped or damped "
        "(default 0)",
    )


def _add_output(group: Arguments) -> None:
    group.add_argument("--no-refine", action="store_true", help="leave out the maps that only play --refine needs")
    group.add_argument("--report", type=Path, metavar="FOLDER", help="write a report with pictures and JSON here")
    add_verbose(group, "clusters, damping, and sizes of the maps")
    add_cluster(group, "solve the windows of the inverse")


def _add_cut(group: Arguments) -> None:
    group.add_argument(
        "--max-cluster",
        type=int,
        metavar="PIXELS",
        help="find a cut into clusters of at most this many projector pixels (default 1000; 200 with --inverse thesis)",
    )
    group.add_argument(
        "--cut",
        type=float,
        nargs=3,
        metavar=("RADIUS", "TAU_1", "TAU_2"),
        help="cut with the parameters of the thesis (Appendix A), such as 5 0.3 1, instead of by --max-cluster: radius "
        "of a neighbourhood in pixels; share of its strongest connection up to which others are cut; share of its "
        "strongest connection from which a cut-off pixel is reconnected",
    )
    group.add_argument(
        "--tau",
        type=float,
        metavar="SHARE",
        help="with --inverse thesis: drop entries of T below this share of white (default 0.001 with far light, "
        "otherwise 0)",
    )

"""counterlight acquire: measure a room with projectors and cameras, or a simulated room, into a calibration folder.

Patterns are black and white, so that T does not depend on the projector's response. With --pictures you choose the
number of pictures, and all measurements use these. Captures are saved as they arrive; the same command resumes an
interrupted acquisition.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from counterlight.command import Arguments, Parser, add_verbose, at_least_0, command_line, conclusion, verb
from counterlight.errors import InputError
from counterlight.response import projector_response
from counterlight.tools.acquisition.rig_options import add_rig_options, sources_of
from counterlight.tools.acquisition.room_options import add_room_options, add_tolerance
from counterlight.tools.choices import SCHEMES
from counterlight.writing.outputs import check_apart, check_folder

if TYPE_CHECKING:
    from counterlight.tools.acquisition.averaging import Aim
    from counterlight.tools.acquisition.cameras.camera import Camera
    from counterlight.tools.acquisition.plan import MakeScheme
    from counterlight.tools.acquisition.preflight import Finding
    from counterlight.tools.acquisition.schemes.hierarchical import Threshold
    from counterlight.tools.acquisition.store import Wanted

MOST_PICTURES = 1 << 12
AVERAGED = "hierarchical", "multiplexed"  # other schemes serve for comparison and are not averaged
MINUTES = 10.0
RADIANCE = "radiance="
EXAMPLES = (
    "counterlight acquire --camera v4l2:0 --exposures 0.03 --monitor 1 -o room",
    "counterlight acquire --camera simulated:corner -o room",
)
COMMON = (
    *("--projector", "--monitor", "--window", "--exposures", "--shots", "--camera-response"),
    *("--preview", "--pictures", "--averaging", "--response", "--name", "--force", "--report", "--verbose"),
)
THRESHOLDS = "expected a multiple of the noise such as 4, or a radiance such as radiance=0.01"


@verb
def main(argv: Sequence[str] | None) -> None:
    options = _parser().parse_args(argv)
    _choose_scheme(options)
    from counterlight.tools.acquisition.acquired_room import Plan, acquire_room
    from counterlight.tools.acquisition.few.acquire import check_count
    from counterlight.tools.acquisition.rig import open_rig
    from counterlight.tools.acquisition.schemes.blocks import is_wide
    from counterlight.tools.acquisition.store import Wanted
    from counterlight.tools.jobs import one_thread
    from counterlight.tools.report.acquired import write_acquisition_report

    output: Path = options.output
    captures = options.captures = options.captures or output.parent / f"{output.name}.captures"
    report_folder = options.report or output.parent / f"{output.name}.report"
    make_scheme = None if options.pictures else _scheme(options)
    aim = _aim(options)
    wanted = Wanted(output, anew=options.force, reuse=options.reuse_captures)
    _check_outputs(options, wanted, captures, report_folder)
    response = None if options.response is None else projector_response(options.response)
    decides = {} if options.pictures else {"threshold": str(_threshold(options)), "tile": options.tile or 0}
    if options.preview and not wanted.reuse and not _aimed(options):
        action = command_line("acquire", "--camera", options.camera[0], "--preview", "-o", output)
        print(conclusion("nothing acquired", action))
        return
    # One BLAS thread: two made small products several times slower.
    with one_thread(), open_rig(options) as (camera, projectors):
        if options.pictures:
            check_count(options.pictures, projectors)
        findings = [] if options.no_preflight or wanted.reuse else _checked(camera)
        monitors = tuple(options.monitor) if len(projectors) > 1 else ()
        pictures = options.pictures or 0
        if options.scheme == "hierarchical" and any(map(is_wide, projectors)):
            decides["even"] = "whole"  # older versions divided all blocks and captured other pictures
        plan = Plan(
            options.scheme, make_scheme, projectors, decides, response, options.tolerance, monitors, pictures, aim
        )
        report = acquire_room(camera, plan, captures, wanted, name=options.name)
        print("\n".join(report.lines(verbose=options.verbose)))
        print(f"{output}: written; the captures stay in {captures}")
        for warning in report.warnings:
            print(f"warning: {warning}", file=sys.stderr)
        print(f"{write_acquisition_report(output, report, findings, report_folder)}: the report")
        result = f"{output}: measured, {100 * report.covered:.1f} % of the projector's pixels seen"
        result += f", {report.expected.short}" if report.expected else ""
        print(conclusion(result, command_line("build", output)))


def _choose_scheme(options: argparse.Namespace) -> None:
    """Set the scheme and its threshold; InputError for options that --pictures does not take."""
    if options.pictures is None:
        options.scheme = options.scheme or "hierarchical"
        options.threshold = "4" if options.threshold is None else options.threshold
        if options.tile is not None and options.scheme != "multiplexed":
            raise InputError(f"--tile {options.tile}: of no meaning to --scheme {options.scheme}; leave it out")
        return
    for name in ("scheme", "threshold", "tile", "averaging"):
        if (given := getattr(options, name)) not in (None, 0.0):  # --averaging 0 is what --pictures does
            raise InputError(f"--{name} {given}: of no meaning to --pictures; leave one of them out")
    options.scheme = "pictures"


def _check_outputs(options: argparse.Namespace, wanted: "Wanted", captures: Path, report: Path) -> None:
    """Raises InputError, before anything is shown, if an output cannot be written or would overwrite something."""
    from counterlight.calibration import refuse_existing
    from counterlight.tools.acquisition.store import check_captures
    from counterlight.tools.report.report import check_report_folder

    output = wanted.room
    read = sources_of(options.camera)
    for folder in (output, captures, report):
        check_folder(folder, inputs=read)
    check_apart(output, captures, report)
    refuse_existing(output, force=wanted.anew)
    check_captures(captures, wanted)
    check_report_folder(report)


def _aimed(options: argparse.Namespace) -> bool:
    """Aim the camera with the live preview and set the chosen exposures; False if the user quits."""
    from counterlight.tools.acquisition.preview import preview

    chosen = preview(options)
    if chosen is None:
        return False
    if chosen != (options.exposures or (1.0,)):
        options.exposures = tuple(float(f"{time:.4g}") for time in chosen)  # rounded to the digits printed below
        times = ",".join(f"{time:g}" for time in options.exposures)
        print(f"exposures chosen; to go on after an interruption: --exposures {times}", flush=True)
    return True


def _checked(camera: "Camera") -> "list[Finding]":
    """Print the findings of the pre-flight; InputError at the first bad finding."""
    from counterlight.tools.acquisition.cameras.live import LiveCamera
    from counterlight.tools.acquisition.preflight import preflight, refuse_bad

    findings = []
    for finding in preflight(camera) if isinstance(camera, LiveCamera) else ():
        print(finding, flush=True)
        refuse_bad(finding)
        findings.append(finding)
    return findings


def _scheme(options: argparse.Namespace) -> "MakeScheme":
    from counterlight.tools.acquisition.schemes.graycode import GrayCodeScheme
    from counterlight.tools.acquisition.schemes.hierarchical import HierarchicalScheme
    from counterlight.tools.acquisition.schemes.multiplexed import MultiplexedScheme

    match options.scheme:
        case "hierarchical":
            return HierarchicalScheme(_threshold(options), options.captures.parent)
        case "multiplexed":
            return MultiplexedScheme(options.tile)
        case _:
            return GrayCodeScheme()


def _aim(options: argparse.Namespace) -> "Aim | None":
    """Returns the aim of repeated captures; None if each picture is taken once, or as often as --shots says.

    Without --wait, the cost of a folder's captures is unknown, so there is no aim.
    """
    from counterlight.tools.acquisition.averaging import Aim

    unpaced = options.camera[0].startswith("folder:") and not options.wait
    for given, name in ((options.shots, f"--shots {options.shots}"), (unpaced, "--camera folder: without --wait")):
        if given and options.averaging:  # 0 captures each picture once, as these do
            raise InputError(f"--averaging {options.averaging:g}: of no meaning with {name}; leave one of them out")
    minutes = MINUTES if options.averaging is None else options.averaging
    if options.pictures or options.shots or unpaced or not minutes or options.scheme not in AVERAGED:
        return None
    return Aim(seconds=60 * minutes)


def _minutes(text: str) -> float:
    return at_least_0(text, f"expected a number of minutes, 0 or more, found {text!r}")


def _threshold(options: argparse.Namespace) -> "Threshold":
    """Parse `4` and `4x` as multiples of the noise, and `radiance=0.01` as a radiance."""
    from counterlight.tools.acquisition.schemes.hierarchical import Threshold

    text: str = options.threshold
    absolute = text.startswith(RADIANCE)
    try:
        number = float(text.removeprefix(RADIANCE) if absolute else text.removesuffix("x"))
    except ValueError:
        raise InputError(f"--threshold {text}: {THRESHOLDS}") from None
    if 0 < number < 1 and not absolute and not text.endswith("x"):
        raise InputError(f"--threshold {text}: less than the noise would take noise for light; {THRESHOLDS}")
    return Threshold(absolute=number) if absolute else Threshold(sigmas=number)


def _count(text: str) -> int:
    if not (text.isdecimal() and 1 <= int(text) <= MOST_PICTURES):
        raise argparse.ArgumentTypeError(f"expected a number of pictures from 9 to {MOST_PICTURES}, found {text!r}")
    return int(text)


def _parser() -> Parser:
    parser = Parser("acquire", description=__doc__, examples=EXAMPLES, common=COMMON)
    add_rig_options(parser, "as the noise requires, within --averaging", "measured; linear for RAW")
    _add_measurement(parser.add_argument_group("measurement"))
    _add_files(parser.add_argument_group("files"))
    return parser


def _add_measurement(group: Arguments) -> None:
    group.add_argument(
        "--preview", action="store_true", help="aim, focus and expose with a live picture before the measurement"
    )
    group.add_argument(
        "--pictures",
        type=_count,
        metavar="N",
        help="measure with N pictures in all, the most important first; at least 9, or 13 for projectors above 256 "
        "pixels (default: as many as --scheme needs)",
    )
    group.add_argument("--scheme", choices=SCHEMES, help="choose the patterns (default hierarchical)")
    group.add_argument(
        "--threshold",
        metavar="N|radiance=R",
        help="ignore light below N times the noise, or below the radiance R (default 4)",
    )
    group.add_argument(
        "--tile", type=int, metavar="PIXELS", help="set the window side of --scheme multiplexed (default: measured)"
    )
    group.add_argument(
        "--averaging",
        type=_minutes,
        metavar="MINUTES",
        help=f"repeat captures against noise while the acquisition takes at most this; 0: never (default {MINUTES:g})",
    )
    add_tolerance(group)


def _add_files(group: Arguments) -> None:
    add_room_options(group, "measured")
    group.add_argument(
        "--captures", type=Path, metavar="FOLDER", help="keep the captures here (default OUTPUT.captures)"
    )
    group.add_argument(
        "--reuse-captures", action="store_true", help="make the room again from the captures, without photographing"
    )
    group.add_argument("--report", type=Path, metavar="FOLDER", help="write the report here (default OUTPUT.report)")
    add_verbose(group, "clusters and entries of T")

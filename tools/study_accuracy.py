"""counterlight study: what accuracy costs in time, measured on scenes and calibrations; figures, plots and a report."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from counterlight.command import Parser, at_least_0, parse_size, run
from counterlight.tools.choices import STUDIED_PICTURES, USUAL_PICTURES
from counterlight.tools.cluster_option import add_cluster, workers_of
from counterlight.tools.colour.option import add_colour
from counterlight.tools.shipped import shipped_scenes
from counterlight.writing.outputs import check_folder


def main(argv: Sequence[str] | None = None) -> int:
    return run(_main, argv)


def _main(argv: Sequence[str] | None) -> None:
    options = _parser().parse_args(argv)
    from counterlight.tools.study.jobs import files_of
    from counterlight.tools.study.pictures import find_pictures
    from counterlight.tools.study.rooms import find_places
    from counterlight.tools.study.study import StudyOptions, check_output, run_study

    check_folder(options.output, inputs=[*options.rooms, *map(Path, options.pictures)])
    check_output(options.output)
    places = find_places(options.rooms, options.scenes)
    find_pictures(options.pictures)
    study = StudyOptions(places, options.pictures, options.size, options.patience, options.table_6_1, options.colour)
    with workers_of(options.cluster, files_of(places, options.pictures), None) as workers:
        for line in run_study(study, options.output, workers):
            print(line, flush=True)


def _seconds(text: str) -> float:
    return at_least_0(text, f"expected a number of seconds, 0 or more, found {text!r}")


def _parser() -> argparse.ArgumentParser:
    parser = Parser("study", description=__doc__)
    parser.add_argument(
        "rooms",
        nargs="*",
        type=Path,
        metavar="CALIBRATION_OR_SCENE",
        help="calibration folders and scene files (default: the shipped scenes)",
    )
    parser.add_argument(
        "-o", "--output", type=Path, default=Path("study"), metavar="FOLDER", help="the report (default study)"
    )
    parser.add_argument(
        "--size",
        type=parse_size,
        default=(72, 96),
        metavar="WxH",
        help="scenes' cameras are fitted into it (default 96x72)",
    )
    parser.add_argument(
        "--scenes", nargs="+", default=[], metavar="NAME", help=f"shipped scenes: {', '.join(shipped_scenes())}"
    )
    parser.add_argument(
        "--pictures",
        nargs="+",
        default=USUAL_PICTURES,
        metavar="NAME_OR_FILE",
        help=f"of {', '.join(STUDIED_PICTURES)}, or files (default {' '.join(USUAL_PICTURES)});"
        " the first two are shown in the report",
    )
    parser.add_argument(
        "--patience",
        type=_seconds,
        default=10.0,
        metavar="SECONDS",
        help="turn knobs of the uncut inverse only where computing it takes at most this (default 10)",
    )
    parser.add_argument(
        "--table-6-1", action="store_true", help="also measure the thesis' scenes at its sizes (takes longer)"
    )
    add_colour(parser)
    add_cluster(parser, "rooms are opened and methods tried")
    return parser


if __name__ == "__main__":
    sys.exit(main())

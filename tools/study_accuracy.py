"""counterlight study: measure what accuracy costs in time, in scenes and calibrated rooms, and write a report."""

from collections.abc import Sequence
from pathlib import Path

from counterlight.command import Parser, command_line, conclusion, parse_seconds, parse_size, verb
from counterlight.tools.choices import STUDIED_PICTURES, USUAL_PICTURES
from counterlight.tools.shared_options import add_cluster, add_colour, workers_of
from counterlight.tools.shipped import shipped_scenes
from counterlight.writing.outputs import check_folder

EXAMPLES = "counterlight study room --size 160x120", "counterlight study --scenes corner glass -o report"
COMMON = "--output", "--scenes", "--pictures", "--size", "--patience"


@verb
def main(argv: Sequence[str] | None) -> None:
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
    action = command_line("build", options.rooms[0]) if options.rooms else command_line("study", "ROOM")
    print(conclusion(f"{options.output}: studied {', '.join(place.stem for place in places)}", action))


def _parser() -> Parser:
    parser = Parser("study", description=__doc__, examples=EXAMPLES, common=COMMON)
    parser.add_argument(
        "rooms",
        nargs="*",
        type=Path,
        metavar="ROOM",
        help="calibration folders or scene files (default: shipped scenes)",
    )
    add = parser.add_argument
    add(
        "-o",
        "--output",
        type=Path,
        default=Path("study"),
        metavar="FOLDER",
        help="write the report here (default study)",
    )
    add(
        "--scenes",
        nargs="+",
        default=[],
        metavar="NAME",
        help=f"study these shipped scenes: {', '.join(shipped_scenes())} (default: all, without ROOM)",
    )
    add(
        "--pictures",
        nargs="+",
        default=USUAL_PICTURES,
        metavar="NAME|FILE",
        help=f"study these pictures: files, or {', '.join(STUDIED_PICTURES)}; the report shows the first two (default "
        f"{' '.join(USUAL_PICTURES)})",
    )
    add(
        "--size",
        type=parse_size,
        default=(72, 96),
        metavar="WxH",
        help="fit the cameras of scenes into this size (default 96x72)",
    )
    add(
        "--patience",
        type=parse_seconds,
        default=10.0,
        metavar="SECONDS",
        help="vary the parameters of the whole inverse only in rooms where one inverse takes at most this (default 10)",
    )
    add("--table-6-1", action="store_true", help="also measure the scenes of the thesis at the thesis' sizes (slow)")
    add_colour(parser)
    add_cluster(parser, "measure the rooms")
    return parser

"""counterlight simulate: a calibration folder from a described room, with only the effects that it calls for."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from counterlight.command import Parser, parse_decibels, parse_size, run
from counterlight.errors import InputError
from counterlight.tools.acquisition.room_options import add_tolerance
from counterlight.tools.choices import BLUR_TOLERANCE
from counterlight.tools.cluster_option import add_cluster, workers_of
from counterlight.tools.shipped import parse_scene

if TYPE_CHECKING:
    from counterlight.jobs.workers import Workers
    from counterlight.tools.simulation.scene import Scene
    from counterlight.tools.simulation.simulate import Simulated


BLURRED = "rows of T that are too long for maps, far out of focus at many pixels, become blocks of projector pixels"


def main(argv: Sequence[str] | None = None) -> int:
    return run(_main, argv)


def _main(argv: Sequence[str] | None) -> None:
    options = _parser().parse_args(argv)
    if options.output is None and not options.explain:
        raise InputError("counterlight simulate: nothing to do; give -o FOLDER, --explain or both")
    if options.output is None:
        _simulate(options)
        return
    from counterlight import calibration
    from counterlight.tools.simulation.room import fill_simulated_room

    with calibration.replacing(options.output, force=options.force, inputs=[options.scene]) as stage:
        words = fill_simulated_room(*_simulate(options), stage)
    print(f"{options.output}: {words}")


def _simulate(options: argparse.Namespace) -> "tuple[Scene, list[Simulated]]":
    """Simulate in this process or on a cluster."""
    with workers_of(options.cluster, [options.scene], None) as workers:
        return _simulated(options, workers)


def _simulated(options: argparse.Namespace, workers: "Workers | None") -> "tuple[Scene, list[Simulated]]":
    from counterlight.tools.simulation.bands import Elsewhere, SceneSource
    from counterlight.tools.simulation.needs import chosen, needs_of
    from counterlight.tools.simulation.scene import load_scene
    from counterlight.tools.simulation.simulate import simulate

    scene = load_scene(options.scene).resized(options.camera, options.projector)
    results, asked = [], options.explain or options.within is not None
    for number, view in enumerate(scene.views, 1):
        needs = chosen(needs_of(view), options.without, options.only)
        if asked:
            from counterlight.tools.study.worth import priced

            needs = priced(view, needs, options.within)
        source = SceneSource(options.scene.absolute(), options.camera, options.projector, number - 1)
        elsewhere = None if workers is None else Elsewhere(workers, source)
        results.append(simulate(view, needs, tolerance=options.tolerance, elsewhere=elsewhere))
        seen = f"camera {number}\n" if scene.others else ""
        print(f"{seen}{results[-1].explained(all_effects=asked)}")
    return scene, results


def _parser() -> argparse.ArgumentParser:
    parser = Parser("simulate", description=__doc__)
    parser.add_argument(
        "scene", type=parse_scene, metavar="SCENE", help="the room: a file, or the name of a shipped one"
    )
    parser.add_argument("-o", "--output", type=Path, metavar="FOLDER", help="the calibration folder")
    parser.add_argument("--camera", type=parse_size, metavar="WxH", help="camera pixels, instead of the scene's")
    parser.add_argument("--projector", type=parse_size, metavar="WxH", help="projector pixels, instead of the scene's")
    parser.add_argument(
        "--explain",
        action="store_true",
        help="say of every effect why it is on or off, what it costs, and what it is worth in dB of the final picture",
    )
    parser.add_argument(
        "--within",
        type=parse_decibels,
        metavar="DB",
        help="leave out what costs and is worth no more than this of the final picture in all, such as 0.1dB",
    )
    parser.add_argument("--without", nargs="+", action="extend", default=[], metavar="EFFECT", help="leave effects out")
    parser.add_argument("--only", nargs="+", action="extend", default=[], metavar="EFFECT", help="leave all others out")
    add_tolerance(parser, BLURRED, BLUR_TOLERANCE)
    add_cluster(parser, "bands of the camera's picture are traced")
    parser.add_argument("--force", action="store_true", help="replace a calibration that is there already")
    return parser


if __name__ == "__main__":
    sys.exit(main())

"""counterlight simulate: compute the calibration of a described room, with only the effects that matter in it."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from counterlight.command import Arguments, Parser, command_line, conclusion, parse_decibels, parse_size, verb
from counterlight.errors import InputError
from counterlight.tools.acquisition.room_options import add_tolerance
from counterlight.tools.choices import BLUR_TOLERANCE
from counterlight.tools.shared_options import add_cluster, workers_of
from counterlight.tools.shipped import parse_scene, shipped_scenes

if TYPE_CHECKING:
    from counterlight.jobs.workers import Workers
    from counterlight.tools.simulation.scene import Scene
    from counterlight.tools.simulation.simulate import Simulated


EXAMPLES = "counterlight simulate corner -o room", "counterlight simulate scene.toml --explain --within 0.1dB -o room"
COMMON = "--output", "--camera", "--projector", "--force", "--explain", "--within", "--without"
BLURRED = "join projector pixels to blocks where the picture is far out of focus,"


@verb
def main(argv: Sequence[str] | None) -> None:
    options = _parser().parse_args(argv)
    if options.output is None and not options.explain:
        raise InputError("counterlight simulate: nothing to do; give -o FOLDER, --explain or both")
    if options.output is None:
        _simulate(options)
        action = command_line("simulate", options.scene, "-o", "ROOM")
        print(conclusion(f"{options.scene.stem}: explained, and nothing was written", action))
        return
    from counterlight import calibration
    from counterlight.tools.simulation.room import fill_simulated_room

    with calibration.replacing(options.output, force=options.force, inputs=[options.scene]) as stage:
        words = fill_simulated_room(*_simulate(options), stage)
    print(f"{options.output}: {words}")
    print(conclusion(f"{options.output}: simulated", command_line("build", options.output)))


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


def _parser() -> Parser:
    parser = Parser("simulate", description=__doc__, examples=EXAMPLES, common=COMMON)
    parser.add_argument(
        "scene",
        type=parse_scene,
        metavar="SCENE",
        help=f"scene file, or a shipped scene: {', '.join(shipped_scenes())}",
    )
    add = parser.add_argument
    add("-o", "--output", type=Path, metavar="FOLDER", help="write the calibration here")
    add("--camera", type=parse_size, metavar="WxH", help="set the camera's size in pixels (default: the scene's)")
    add("--projector", type=parse_size, metavar="WxH", help="set the projector's size in pixels (default: the scene's)")
    add("--force", action="store_true", help="replace an existing calibration")
    _add_effects(parser.add_argument_group("effects"))
    _add_computation(parser.add_argument_group("computation"))
    return parser


def _add_effects(group: Arguments) -> None:
    group.add_argument(
        "--explain",
        action="store_true",
        help="print for each effect why it is on or off, its cost, and its worth in dB of the final picture",
    )
    group.add_argument(
        "--within",
        type=parse_decibels,
        metavar="DB",
        help="leave out costly effects that are together worth at most this, such as 0.1dB (default: leave out none)",
    )
    group.add_argument(
        "--without", nargs="+", action="extend", default=[], metavar="EFFECT", help="leave out these effects"
    )
    group.add_argument(
        "--only", nargs="+", action="extend", default=[], metavar="EFFECT", help="leave out all other effects"
    )


def _add_computation(group: Arguments) -> None:
    add_tolerance(group, BLURRED, BLUR_TOLERANCE)
    add_cluster(group, "trace the camera picture")

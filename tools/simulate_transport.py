"""simulate-transport: a calibration folder from a described room, with only the effects that it calls for."""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from player import calibration
from player.command import Parser, parse_size, run
from tools.simulation.room import write_simulated_room
from tools.simulation.scene import load_scene


def main(argv: Sequence[str] | None = None) -> int:
    return run(_main, argv)


def _main(argv: Sequence[str] | None) -> None:
    options = _parser().parse_args(argv)
    calibration.refuse_existing(options.output, force=options.force)
    scene = load_scene(options.scene)
    if options.camera:
        scene = replace(scene, camera=scene.camera.resized(*options.camera))
    if options.projector:
        scene = replace(scene, projector=scene.projector.resized(*options.projector))
    print(write_simulated_room(scene, options.output, force=options.force))


def _parser() -> argparse.ArgumentParser:
    parser = Parser("simulate-transport", description=__doc__)
    parser.add_argument("scene", type=Path, metavar="SCENE.toml", help="the room; see calib_data/scenes")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FOLDER", help="the calibration folder")
    parser.add_argument("--camera", type=parse_size, metavar="WxH", help="camera pixels, instead of the scene's")
    parser.add_argument("--projector", type=parse_size, metavar="WxH", help="projector pixels, instead of the scene's")
    parser.add_argument("--force", action="store_true", help="replace a calibration that is there already")
    return parser


if __name__ == "__main__":
    sys.exit(main())

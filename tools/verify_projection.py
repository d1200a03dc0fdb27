"""counterlight verify: project a compensated picture, photograph it, compare with the prediction and with the picture.

The camera stands where it stood when the calibration was made, with the same settings. With --camera folder:DIR
pictures and captures are exchanged as counterlight acquire does: the same command again after each.
"""

import argparse
import hashlib
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from counterlight.command import Parser, run
from counterlight.errors import InputError
from counterlight.tools.acquisition.rig_options import add_rig_options
from counterlight.tools.choices import VERIFIED
from counterlight.tools.colour.option import add_colour
from counterlight.tools.objective_options import add_objective_options
from counterlight.writing.outputs import check_folder
from counterlight.writing.replacing import replacing_folder

if TYPE_CHECKING:
    from counterlight.calibration import StoredCalibration
    from counterlight.tools.acquisition.verify import Verification, Verified


def main(argv: Sequence[str] | None = None) -> int:
    return run(_main, argv)


def _main(argv: Sequence[str] | None) -> None:
    options = _parser().parse_args(argv)
    from counterlight.calibration import check_order

    check_order(options.calibration, [options.picture])
    if options.output is None:
        _verify(options)
        return
    _refuse_existing(options.output)
    with replacing_folder(options.output, _refuse_existing) as stage:
        task, best = _verify(options)
        _write(stage, task, best)
    print(f"{options.output}: round {best.round}, written")


def _verify(options: argparse.Namespace) -> "tuple[Verification, Verified]":
    """Print every round; returns what was verified and the best one."""
    from threadpoolctl import threadpool_limits

    from counterlight import calibration as calibrations
    from counterlight.tools.acquisition.cameras.folder import FolderCamera
    from counterlight.tools.acquisition.cameras.live import LiveCamera
    from counterlight.tools.acquisition.preflight import preflight, refuse_bad
    from counterlight.tools.acquisition.rig import open_rig
    from counterlight.tools.acquisition.verify import Verification
    from counterlight.tools.relighting.pictures import read_placed
    from counterlight.tools.transport.objective import ObjectiveOptions

    stored = calibrations.read(options.calibration)
    room = stored.calibration
    picture = read_placed(options.picture, room.camera.shape)
    with threadpool_limits(limits=1), open_rig(options) as (camera, projector):
        if projector != room.projector.shape:
            swapped = projector[::-1] == room.projector.shape
            fix = "width and height are swapped" if swapped else "choose the calibrated one"
            raise InputError(
                f"the projector has {projector[1]}x{projector[0]} pixels, {options.calibration} is for "
                f"{room.projector.width}x{room.projector.height}; {fix}"
            )
        if isinstance(camera, FolderCamera):
            camera.bind(_exchange(options, stored), first=True)
        if isinstance(camera, LiveCamera) and not options.no_preflight:
            for finding in preflight(camera):
                refuse_bad(finding)
        aims = ObjectiveOptions(options.drift, options.outside)
        radiance = options.picture.suffix.lower() == ".exr"
        task = Verification(
            camera,
            stored,
            picture,
            radiance=radiance,
            solver=options.solver,
            colour=options.colour,
            aims=aims,
        )
        print(task.tier)
        print(f"white is a camera radiance of {task.white:.4g}; {int(room.mask.sum())} camera pixels count")
        found = []
        for result in task.run(options.rounds, options.repeats):
            print(result, flush=True)
            found.append(result)
    return task, max(found, key=lambda each: each.measured_psnr)


def _exchange(options: argparse.Namespace, stored: "StoredCalibration") -> str:
    """What a folder's captures are of: this room, picture and solver; another verification is not given them."""
    picture = options.picture.read_bytes()
    said = f"{stored.fingerprint} {options.solver} {options.repeats}".encode()
    return hashlib.sha256(said + picture).hexdigest()


def _refuse_existing(folder: Path) -> None:
    check_folder(folder)
    if folder.exists():
        raise InputError(f"{folder}: exists; name another folder")


def _write(stage: Path, task: "Verification", best: "Verified") -> None:
    from counterlight.files.png import write_png
    from counterlight.tools.relighting.pictures import write_view

    write_png(stage / "projected.png", best.codes)
    for name, view in (("desired", task.desired), ("predicted", best.predicted), ("captured", best.captured)):
        write_view(stage / f"{name}.png", view, task.white)


def _whole(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"expected a whole number, found {text!r}")
    return int(text)


def _parser() -> argparse.ArgumentParser:
    parser = Parser("verify", description=__doc__)
    parser.add_argument("calibration", type=Path, help="a calibration folder")
    parser.add_argument("picture", type=Path, help="what the camera is to see; .exr is radiance, pixel by pixel")
    parser.add_argument("--solver", choices=VERIFIED, default="box", help="default box; map: as the player does it")
    parser.add_argument("--rounds", type=_whole, default=0, metavar="N", help="of feedback (default 0)")
    parser.add_argument("--repeats", type=_whole, default=4, metavar="N", help="captures averaged (default 4)")
    parser.add_argument("-o", "--output", type=Path, metavar="FOLDER", help="projected.png and what was seen of it")
    add_colour(parser)
    add_objective_options(parser)
    add_rig_options(parser)
    return parser


if __name__ == "__main__":
    sys.exit(main())

"""counterlight verify: check whether the room is as it was calibrated, and how well a compensated picture arrives.

Cameras must stand where they stood for the calibration, with the same settings; all projectors and cameras take part.
A moved projector picture, a dimmed lamp and changed room light are found and corrected. counterlight play uses the
correction when it starts or is asked to reload. Exit code 3: the calibration no longer holds, acquire again.
"""

import argparse
import hashlib
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from counterlight.command import Arguments, Parser, command_line, conclusion, tell, verb
from counterlight.errors import InputError
from counterlight.tools.acquisition.rig_options import add_rig_options
from counterlight.tools.choices import VERIFIED
from counterlight.tools.shared_options import add_colour, add_objective_options, aims_of
from counterlight.writing.outputs import check_folder
from counterlight.writing.replacing import replacing_folder

if TYPE_CHECKING:
    from counterlight.calibration import Calibration, StoredCalibration
    from counterlight.raster import Shapes
    from counterlight.tools.acquisition.cameras.camera import Camera
    from counterlight.tools.acquisition.photographer import Photographer
    from counterlight.tools.acquisition.verify import Verification, Verified, Wanted
    from counterlight.tools.transport.transport import Transport

EXAMPLES = (
    "counterlight verify room --camera v4l2:0 --exposures 0.03 --monitor 1",
    "counterlight verify room picture.png --camera folder:shots --rounds 2",
)
COMMON = (
    *("--projector", "--monitor", "--window", "--exposures", "--no-correct", "--watch", "--control"),
    *("--rounds", "--output", "--solver"),
)
LOST = 3  # exit code if the calibration no longer holds
WATCH_S = 600.0


@verb
def main(argv: Sequence[str] | None) -> int:
    options = _parser().parse_args(argv)
    from counterlight.calibration import check_order

    check_order(options.calibration, [options.picture])
    if options.picture is None and (options.rounds or options.output is not None):
        raise InputError("--rounds and -o are of a PICTURE; name one, or leave them out")
    if options.watch is not None and options.picture is not None:
        raise InputError("--watch looks at the room again and again; leave out PICTURE")
    if options.output is None:
        return _verify(options, None)
    _refuse_existing(options.output)
    with replacing_folder(options.output, _refuse_existing) as stage:
        return _verify(options, stage)


def _verify(options: argparse.Namespace, stage: Path | None) -> int:
    from counterlight import calibration as calibrations
    from counterlight.tools.acquisition.cameras.live import LiveCamera
    from counterlight.tools.acquisition.preflight import preflight, refuse_bad
    from counterlight.tools.acquisition.rig import open_rig
    from counterlight.tools.jobs import one_thread
    from counterlight.tools.transport.storage import read_transport
    from counterlight.unattended.json_lines import check_control

    stored = calibrations.read(options.calibration)
    if options.control is not None and options.watch is None:
        check_control(options.control)
    transport = read_transport(stored)
    wanted = _wanted(options, stored, transport)
    refuse = partial(_check_projectors, options, stored.calibration)
    with one_thread(), open_rig(options, refuse, stored.calibration.camera.response) as (camera, _):
        if isinstance(camera, LiveCamera) and not options.no_preflight:
            for finding in preflight(camera):
                refuse_bad(finding)
        while True:
            with _photographing(camera, stored, options) as photographer:
                code = _once(options, stored, transport, photographer, wanted, stage)
            if options.watch is None:
                return code
            time.sleep(options.watch)


def _wanted(options: argparse.Namespace, stored: "StoredCalibration", transport: "Transport") -> "Wanted | None":
    """Returns the picture, read and checked before anything is shown; None without a picture."""
    from counterlight.tools.acquisition.verify import Wanted
    from counterlight.tools.relighting.pictures import read_placed

    aims = aims_of(options)
    if options.picture is None:
        return None
    return Wanted(
        stored,
        transport,
        read_placed(options.picture, stored.calibration.camera.shape, stored.calibration.screen),
        radiance=options.picture.suffix.lower() == ".exr",
        solver=options.solver,
        colour=options.colour,
        aims=aims,
    )


def _check_projectors(options: argparse.Namespace, room: "Calibration", found: "Shapes") -> None:
    """Raises InputError unless the sizes are the room's, or one projector has the size of the whole raster."""
    wanted = tuple(projector.shape for projector in room.projectors)
    if found in (wanted, (room.projector.shape,)):
        return
    swapped = tuple((width, height) for height, width in found) == wanted
    sizes, expected = (" and ".join(f"{width}x{height}" for height, width in each) for each in (found, wanted))
    many = "s have" if len(found) > 1 else " has"
    fix = "width and height are swapped" if swapped else "choose the calibrated one"
    if len(wanted) > 1 and not swapped:
        fix = "name each of them with --monitor or --projector, from the left"
    raise InputError(f"the projector{many} {sizes} pixels, {options.calibration} is for {expected}; {fix}")


@contextmanager
def _photographing(
    camera: "Camera", stored: "StoredCalibration", options: argparse.Namespace
) -> "Iterator[Photographer]":
    """Yield the photographer of one check; a folder keeps its captures until the check ends, so that it can resume."""
    from counterlight.tools.acquisition.cameras.folder import FolderCamera
    from counterlight.tools.acquisition.photographer import Photographer

    room = stored.calibration
    if not isinstance(camera, FolderCamera):
        yield Photographer(camera, room)
        return
    setting = stored.fingerprint, options.picture, options.rounds, options.repeats, options.solver, options.colour
    first = camera.begin(hashlib.sha256(repr(setting).encode()).hexdigest())
    yield Photographer(camera, room, first)
    camera.end(first)


def _once(
    options: argparse.Namespace,
    stored: "StoredCalibration",
    transport: "Transport",
    photographer: "Photographer",
    wanted: "Wanted | None",
    stage: Path | None,
) -> int:
    """Run one check, and show the picture if there is one; returns the exit code."""
    from counterlight.pipeline.drift import read_drift, write_drift
    from counterlight.tools.acquisition.room_check import check_room, nothing
    from counterlight.unattended.json_lines import ask

    checked, kept = check_room(photographer, stored.calibration, transport), read_drift(stored)
    if checked.lost:
        lost = f"{checked.said}; what is calibrated no longer holds: acquire again"
        print(conclusion(lost, _acquire_again(options)), flush=True)
        return LOST
    drift = (kept or nothing(stored.calibration)) if options.no_correct else checked.drift
    if not options.no_correct:
        write_drift(stored, drift)
        if options.control is not None and (drift.changes or (kept is not None and kept.changes)):
            try:
                ask(options.control, "reload")
            except InputError as error:
                if options.watch is None:
                    raise
                tell(f"{error}")  # a player that starts later reads the stored correction
    outcome = ("not corrected" if options.no_correct else "corrected") if checked.drift.changes else ""
    result = f"{checked.said}: {outcome}" if outcome else checked.said
    if wanted is None and options.watch is None:
        uncorrected = checked.drift.changes and options.no_correct
        verb, rest = ("verify", _cameras(options)) if uncorrected else ("play", ["MEDIA"])
        result = conclusion(result, command_line(verb, options.calibration, *rest))
    print(result, flush=True)
    if wanted is not None:
        from counterlight.tools.acquisition.verify import Verification

        photographer.expose(checked.exposures)
        _show(options, Verification(photographer, stored, wanted, drift, checked.used), stage)
    return 0


def _show(options: argparse.Namespace, task: "Verification", stage: Path | None) -> None:
    """Print every round of the picture and a verdict on the best round; write the best."""
    counting = int(task.tier.calibration.mask.sum())
    print(task.tier)
    print(f"white is a camera radiance of {task.white:.4g}; {counting} camera pixels count")
    found = []
    for result in task.run(options.rounds, options.repeats):
        print(result, flush=True)
        found.append(result)
    best = max(found, key=lambda each: each.measured_psnr)
    if stage is not None:
        _write(stage, task, best)
        print(f"{options.output}: round {best.round}, written")
    play = command_line("play", options.calibration, options.picture)
    print(conclusion(best.verdict, play if best.as_predicted else _acquire_again(options)))


def _acquire_again(options: argparse.Namespace) -> str:
    return command_line("acquire", *_cameras(options), "-o", options.calibration, "--force")


def _cameras(options: argparse.Namespace) -> list[str]:
    return [word for camera in options.camera for word in ("--camera", camera)]


def _refuse_existing(folder: Path) -> None:
    check_folder(folder)
    if folder.exists():
        raise InputError(f"{folder}: exists; name another folder")


def _write(stage: Path, task: "Verification", best: "Verified") -> None:
    from counterlight.files.picture_files import write_png
    from counterlight.tools.relighting.pictures import write_view

    write_png(stage / "projected.png", best.codes)
    for name, view in (("desired", task.desired), ("predicted", best.predicted), ("captured", best.captured)):
        write_view(stage / f"{name}.png", view, task.white)


def _whole(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"expected a whole number of at least 0, found {text!r}")
    return int(text)


def _repeats(text: str) -> int:
    if not (text.isdecimal() and int(text)):
        raise argparse.ArgumentTypeError(f"expected a whole number of at least 1, found {text!r}")
    return int(text)


def _seconds(text: str) -> float:
    try:
        seconds = float(text)
    except ValueError:
        seconds = -1.0
    if not 0 < seconds < 1e7:
        raise argparse.ArgumentTypeError(f"expected a number of seconds above 0, found {text!r}")
    return seconds


def _parser() -> Parser:
    parser = Parser("verify", description=__doc__, examples=EXAMPLES, common=COMMON)
    parser.add_argument("calibration", type=Path, help="calibration folder")
    parser.add_argument(
        "picture",
        type=Path,
        nargs="?",
        help="target picture to project and compare; .exr: camera radiance (default: check the room only)",
    )
    add_rig_options(parser)
    _add_check(parser.add_argument_group("check of the room"))
    _add_picture(parser.add_argument_group("comparison with PICTURE"))
    return parser


def _add_check(group: Arguments) -> None:
    group.add_argument("--no-correct", action="store_true", help="report changes of the room, but do not correct them")
    group.add_argument(
        "--watch",
        type=_seconds,
        nargs="?",
        const=WATCH_S,
        metavar="SECONDS",
        help=f"check again and again at this interval (default {WATCH_S:g} s; without --watch: once)",
    )
    group.add_argument("--control", type=Path, metavar="SOCKET", help="tell the player at this socket to reload")


def _add_picture(group: Arguments) -> None:
    group.add_argument(
        "--rounds", type=_whole, default=0, metavar="N", help="improve the picture in N rounds of feedback (default 0)"
    )
    group.add_argument(
        "-o", "--output", type=Path, metavar="FOLDER", help="write the projected and captured pictures here"
    )
    group.add_argument(
        "--solver",
        choices=VERIFIED,
        default="box",
        help="compute the projector picture by the best solver (box), or as the player does (map; default box)",
    )
    group.add_argument(
        "--repeats", type=_repeats, default=4, metavar="N", help="average N captures of the picture (default 4)"
    )
    add_colour(group)
    add_objective_options(group)

"""What the commands with a camera share: which camera, what the projector is, and how they are opened."""

import argparse
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from counterlight.calibration import Device
from counterlight.command import parse_size
from counterlight.errors import InputError
from counterlight.response import Response, named_response
from counterlight.tools.acquisition.cameras.camera import Camera, Exposures
from counterlight.tools.acquisition.cameras.folder import FolderCamera
from counterlight.tools.acquisition.cameras.live import Eye, LiveCamera
from counterlight.tools.acquisition.cameras.simulated import (
    MOST_LAG,
    Sensor,
    SimulatedCamera,
    SimulatedRoom,
    VisibleScreen,
    simulated_room,
)

MOST_SHOTS = 256
CAMERAS = "simulated:SCENE.toml, simulated:CALIBRATION, folder:DIR, v4l2:NUMBER or gphoto2"


def add_rig_options(parser: argparse.ArgumentParser) -> None:
    """--camera and what belongs to it."""
    parser.add_argument("--camera", required=True, metavar="CAMERA", help=CAMERAS)
    parser.add_argument("--projector", type=parse_size, metavar="WIDTHxHEIGHT", help="its pixels (a scene knows them)")
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--monitor", metavar="NAME|N", help="the projector, filled with the patterns")
    where.add_argument("--window", action="store_true", help="patterns in a plain window, to try things with")
    parser.add_argument("--desktop", action="store_true", help="the projector may be the primary monitor")
    parser.add_argument(
        "--exposures",
        type=_times,
        metavar="T,T…",
        help="of a bracket, seconds (simulated: factors; default 1)",
    )
    parser.add_argument(
        "--shots", type=_shots, default=1, metavar="N", help="of each exposure, averaged: noise falls by √N (default 1)"
    )
    parser.add_argument("--camera-response", default="linear", metavar="linear|srgb|GAMMA|FILE.toml")
    parser.add_argument("--no-preflight", action="store_true", help="do not check projector and camera first")
    parser.add_argument("--wait", type=float, default=0.0, metavar="SECONDS", help="folder: for captures (default 0)")
    sensor = parser.add_argument_group("simulated camera")
    sensor.add_argument("--bits", type=int, default=14, help="of a code value (default 14)")
    sensor.add_argument("--full-well", type=float, default=20000.0, metavar="ELECTRONS", help="0: no noise")
    sensor.add_argument("--read-noise", type=float, default=5.0, metavar="N", help="electrons (default 5)")
    sensor.add_argument("--lag", type=int, default=0, metavar="FRAMES", help=f"0 to {MOST_LAG} (default 0)")
    sensor.add_argument("--seed", type=int, default=0, help="of its noise (default 0)")


@contextmanager
def open_rig(options: argparse.Namespace, projector: Response) -> Iterator[tuple[Camera, Device]]:
    """The camera and the projector that the options name; InputError for what is not there.

    projector : its response, where the camera does not know it.
    """
    kind, _, source = options.camera.partition(":")
    response = named_response(options.camera_response)
    with ExitStack() as opened:
        if kind == "simulated" and source:
            room = simulated_room(Path(source))
            screen = _screen(options, room.projector, opened) if options.monitor or options.window else None
            yield _simulated(options, room, response, screen), Device(*room.projector, room.response)
        elif kind == "folder" and source:
            size = _needed_size(options)
            exposures = Exposures(_bracket(options), response)
            yield FolderCamera(Path(source), exposures, options.wait), Device(*size, projector)
        elif kind in ("v4l2", "gphoto2") and bool(source) == (kind == "v4l2"):
            if not (options.monitor or options.window):
                raise InputError(f"--camera {kind}: where is the projector? add --monitor NAME (or --window to try)")
            if not options.exposures:
                raise InputError(f"--camera {kind}: needs exposure times in seconds; add --exposures, such as 0.033")
            eye = _eye(kind, source, opened)
            shown = _screen(options, options.projector, opened)
            camera = LiveCamera(shown, eye, Exposures(_bracket(options), response))
            yield camera, Device(*shown.shape, projector)
        else:
            raise InputError(f"--camera {options.camera}: expected {CAMERAS}")


def _simulated(
    options: argparse.Namespace, room: SimulatedRoom, response: Response, screen: VisibleScreen | None
) -> SimulatedCamera:
    if options.projector not in (None, room.projector):
        height, width = room.projector
        raise InputError(f"--projector: the projector of {room.name} has {width}x{height} pixels; leave it out")
    sensor = Sensor(
        options.bits,
        options.full_well,
        options.read_noise,
        _bracket(options),
        response,
        options.seed,
        options.lag,
    )
    return SimulatedCamera(room, sensor, screen)


def _screen(options: argparse.Namespace, shape: tuple[int, int] | None, opened: ExitStack) -> VisibleScreen:
    from counterlight.tools.acquisition.cameras.window import open_screen  # OpenGL, for those who show something

    return opened.enter_context(open_screen(shape, options.monitor, desktop=options.desktop))


def _eye(kind: str, source: str, opened: ExitStack) -> Eye:
    if kind == "v4l2":
        from counterlight.tools.acquisition.cameras.video import open_video_eye

        return opened.enter_context(open_video_eye(source))
    from counterlight.tools.acquisition.cameras.tethered import open_tethered_eye

    return opened.enter_context(open_tethered_eye())


def _needed_size(options: argparse.Namespace) -> tuple[int, int]:
    if options.projector is None:
        raise InputError("--camera folder: needs the projector's size; add --projector WIDTHxHEIGHT")
    size: tuple[int, int] = options.projector
    return size


def _bracket(options: argparse.Namespace) -> tuple[float, ...]:
    """The time of every shot of a capture."""
    return tuple(time for time in options.exposures or (1.0,) for _ in range(options.shots))


def _shots(text: str) -> int:
    if not (text.isdecimal() and 1 <= int(text) <= MOST_SHOTS):
        raise argparse.ArgumentTypeError(f"expected a number of shots from 1 to {MOST_SHOTS}, found {text!r}")
    return int(text)


def _times(text: str) -> tuple[float, ...]:
    try:
        return Exposures(tuple(float(word) for word in text.split(","))).times
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected numbers joined by commas, such as 1,0.1, found {text!r}") from None

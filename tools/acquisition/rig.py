"""The camera and the projector that a command line names, opened."""

import argparse
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

from counterlight.errors import InputError
from counterlight.response import Response, named_response
from counterlight.tools.acquisition.cameras.camera import Camera, Exposures
from counterlight.tools.acquisition.cameras.folder import FolderCamera
from counterlight.tools.acquisition.cameras.live import Eye, LiveCamera
from counterlight.tools.acquisition.cameras.simulated import (
    CameraSettings,
    SimulatedCamera,
    SimulatedRoom,
    VisibleScreen,
    simulated_room,
)
from counterlight.tools.acquisition.rig_options import CAMERAS, SENSOR
from counterlight.tools.simulation.devices import Sensor


@contextmanager
def open_rig(options: argparse.Namespace) -> Iterator[tuple[Camera, tuple[int, int]]]:
    """The camera and the projector's (height, width) that the options name; InputError for what is not there."""
    kind, _, source = options.camera.partition(":")
    response = named_response(options.camera_response)
    with ExitStack() as opened:
        if kind == "simulated" and source:
            room = simulated_room(Path(source))
            screen = _screen(options, room.projector, opened) if options.monitor or options.window else None
            yield _simulated(options, room, response, screen), room.projector
        elif kind == "folder" and source:
            size = _needed_size(options)
            exposures = Exposures(_bracket(options), response)
            yield FolderCamera(Path(source), exposures, options.wait), size
        elif kind in ("v4l2", "pylon", "gphoto2") and bool(source) == (kind != "gphoto2"):
            if not (options.monitor or options.window):
                raise InputError(f"--camera {kind}: where is the projector? add --monitor NAME (or --window to try)")
            if not options.exposures:
                raise InputError(f"--camera {kind}: needs exposure times in seconds; add --exposures, such as 0.033")
            eye = _eye(kind, source, response, opened)
            shown = _screen(options, options.projector, opened)
            camera = LiveCamera(shown, eye, Exposures(_bracket(options), response))
            yield camera, shown.shape
        else:
            raise InputError(f"--camera {options.camera}: expected {CAMERAS}")


def _simulated(
    options: argparse.Namespace, room: SimulatedRoom, response: Response, screen: VisibleScreen | None
) -> SimulatedCamera:
    if options.projector not in (None, room.projector):
        height, width = room.projector
        fix = "width and height are swapped" if options.projector == (width, height) else "leave it out"
        raise InputError(f"--projector: the projector of {room.name} has {width}x{height} pixels; {fix}")
    given = {name: getattr(options, name) for name in SENSOR if getattr(options, name) is not None}
    sensor = replace(room.sensor or Sensor(), **given)
    return SimulatedCamera(room, CameraSettings(sensor, _bracket(options), response, options.seed, options.lag), screen)


def _screen(options: argparse.Namespace, shape: tuple[int, int] | None, opened: ExitStack) -> VisibleScreen:
    from counterlight.tools.acquisition.cameras.window import open_screen  # OpenGL, for those who show something

    return opened.enter_context(open_screen(shape, options.monitor, desktop=options.desktop))


def _eye(kind: str, source: str, response: Response, opened: ExitStack) -> Eye:
    if kind == "v4l2":
        from counterlight.tools.acquisition.cameras.video import open_video_eye

        return opened.enter_context(open_video_eye(source))
    if kind == "pylon":
        from counterlight.tools.acquisition.cameras.machine_vision import open_machine_vision_eye

        return opened.enter_context(open_machine_vision_eye(source))
    from counterlight.tools.acquisition.cameras.tethered import open_tethered_eye

    return opened.enter_context(open_tethered_eye(response))


def _needed_size(options: argparse.Namespace) -> tuple[int, int]:
    if options.projector is None:
        raise InputError("--camera folder: needs the projector's size; add --projector WIDTHxHEIGHT")
    height, width = options.projector
    if height > width:
        print(f"note: a projector {width} pixels wide and {height} high, upright: WIDTHxHEIGHT", file=sys.stderr)
    return height, width


def _bracket(options: argparse.Namespace) -> tuple[float, ...]:
    """The time of every shot of a capture."""
    return tuple(time for time in options.exposures or (1.0,) for _ in range(options.shots))

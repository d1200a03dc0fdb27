"""Open the camera and the projector that a command line names."""

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

from counterlight.errors import InputError
from counterlight.raster import Shapes
from counterlight.response import Response, named_response
from counterlight.tools.acquisition.cameras.camera import LINEAR, Camera, Exposures
from counterlight.tools.acquisition.cameras.folder import FolderCamera
from counterlight.tools.acquisition.cameras.live import CameraDevice, LiveCamera
from counterlight.tools.acquisition.cameras.simulated import (
    CameraSettings,
    SimulatedCamera,
    SimulatedRoom,
    VisibleScreen,
    simulated_rooms,
)
from counterlight.tools.acquisition.cameras.together import together
from counterlight.tools.acquisition.rig_options import CAMERAS, SENSOR
from counterlight.tools.simulation.devices import Sensor

LIVE = "v4l2", "pylon", "gphoto2"


@contextmanager
def open_rig(
    options: argparse.Namespace,
    refuse: Callable[[Shapes], None] = lambda projectors: None,
    curve: Response | None = None,
) -> Iterator[tuple[Camera, Shapes]]:
    """Open the camera and return it with each projector's (height, width); InputError for missing devices.

    refuse : called with the projectors' sizes as soon as they are known; raises InputError for unwanted sizes.
    curve : the camera's response unless --camera-response gives one; None if it is unknown.
    """
    kind, sources = _kind_of(options.camera)
    given = curve if options.camera_response is None else named_response(options.camera_response)
    response, known = given or LINEAR, given is not None
    with ExitStack() as opened:
        if kind == "simulated":

            def refuse_room(name: str, projectors: Shapes, sensor: Sensor | None) -> None:
                _check_sizes(options, name, projectors)
                _settings(options, sensor, response, known=known)
                refuse(projectors)

            rooms = [room for source in sources for room in simulated_rooms(Path(source), refuse_room)]
            projectors = _shared_projectors(rooms)
            shown = options.monitor or options.window
            screen = _screens(options, projectors, opened)[0] if shown else None
            settings = _settings(options, rooms[0].sensor, response, known=known)
            yield SimulatedCamera(rooms[0], settings, screen, rooms[1:]), projectors
        elif kind == "folder":
            sizes = _needed_sizes(options)
            refuse(sizes)
            exposures = Exposures(_bracket(options), response, known)
            yield FolderCamera(Path(sources[0]), exposures, options.wait), sizes
        else:
            if not (options.monitor or options.window):
                raise InputError(f"--camera {kind}: where is the projector? add --monitor NAME (or --window to try)")
            if not options.exposures:
                raise InputError(f"--camera {kind}: needs exposure times in seconds; add --exposures, such as 0.033")
            device = together([open_device(*parted(camera), response, opened) for camera in options.camera])
            screen, shapes = _screens(options, tuple(options.projector), opened)
            refuse(shapes)
            yield LiveCamera(screen, device, Exposures(_bracket(options), response, known)), shapes


def _kind_of(cameras: Sequence[str]) -> tuple[str, list[str]]:
    """Returns the common kind (simulated, folder or a live kind) and the source of each camera."""
    found = [parted(camera) for camera in cameras]
    for camera, (kind, source) in zip(cameras, found, strict=True):
        if kind not in (*LIVE, "simulated", "folder") or bool(source) != (kind != "gphoto2"):
            raise InputError(f"--camera {camera}: expected {CAMERAS}")
        alone = kind == "folder" or (kind == "simulated") != (found[0][0] == "simulated")
        if alone and len(cameras) > 1:
            raise InputError(
                f"--camera {camera}: cannot photograph together with others; acquire with each by itself, then: "
                "counterlight join --cameras"
            )
    return found[0][0], [source for _, source in found]


def parted(camera: str) -> tuple[str, str]:
    kind, _, source = camera.partition(":")
    return kind, source


def _shared_projectors(rooms: Sequence[SimulatedRoom]) -> Shapes:
    """Returns the (height, width) of each projector; InputError if the cameras see different projectors."""
    first = rooms[0]
    for room in rooms[1:]:
        if (room.projectors, room.response) != (first.projectors, first.response):
            raise InputError(
                f"--camera: {room.name} has other projectors than {first.name}; cameras that acquire together see the "
                "same"
            )
    return first.projectors


def _settings(options: argparse.Namespace, sensor: Sensor | None, response: Response, *, known: bool) -> CameraSettings:
    """Returns the camera settings; options override the `sensor` of the scene."""
    given = {name: getattr(options, name) for name in SENSOR if getattr(options, name) is not None}
    if given.get("full_well") == 0:
        given.setdefault("read_noise", 0.0)  # no noise at all, as the help says
    chosen = replace(sensor or Sensor(), **given)
    return CameraSettings(chosen, _bracket(options), response, options.seed, options.lag, known)


def _check_sizes(options: argparse.Namespace, name: str, projectors: Shapes) -> None:
    """Raises InputError if --projector differs from the room's projectors."""
    if not options.projector or tuple(options.projector) == projectors:
        return
    sizes = " and ".join(f"{width}x{height}" for height, width in projectors)
    swapped = tuple((width, height) for height, width in options.projector) == projectors
    fix = "width and height are swapped" if swapped else "leave it out"
    raise InputError(f"--projector: {name} has {sizes} pixels; {fix}")


def _screens(options: argparse.Namespace, shapes: Shapes, opened: ExitStack) -> tuple[VisibleScreen, Shapes]:
    from counterlight.tools.acquisition.cameras.window import open_screens  # OpenGL, imported only if needed

    return opened.enter_context(open_screens(shapes, options.monitor, desktop=options.desktop))


def open_device(kind: str, source: str, response: Response, opened: ExitStack) -> CameraDevice:
    if kind == "v4l2":
        from counterlight.tools.acquisition.cameras.video import open_video_device

        return opened.enter_context(open_video_device(source))
    if kind == "pylon":
        from counterlight.tools.acquisition.cameras.machine_vision import open_machine_vision_device

        return opened.enter_context(open_machine_vision_device(source))
    from counterlight.tools.acquisition.cameras.tethered import open_tethered_device

    return opened.enter_context(open_tethered_device(response))


def _needed_sizes(options: argparse.Namespace) -> Shapes:
    if not options.projector:
        raise InputError("--camera folder: needs the projector's size; add --projector WIDTHxHEIGHT")
    for height, width in options.projector:
        if height > width:
            print(f"note: a projector {width} pixels wide and {height} high, upright: WIDTHxHEIGHT", file=sys.stderr)
    return tuple(options.projector)


def _bracket(options: argparse.Namespace) -> tuple[float, ...]:
    """Returns the exposure time of every shot of a capture."""
    return tuple(time for time in options.exposures or (1.0,) for _ in range(options.shots or 1))

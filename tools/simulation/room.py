"""Conversion of a simulated scene to a calibration folder."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from counterlight import calibration
from counterlight.calibration import Calibration, Device
from counterlight.errors import InputError
from counterlight.response import Response
from counterlight.tools.joining import views as joined_views
from counterlight.tools.joining.cameras import CameraOptions, described, joined_cameras
from counterlight.tools.joining.views import on_shared_screen, write_views
from counterlight.tools.simulation.scene import Scene
from counterlight.tools.simulation.simulate import Simulated
from counterlight.tools.transport.mask import directly_lit
from counterlight.tools.transport.storage import write_transport
from counterlight.tools.transport.transport import Transport
from counterlight.viewpoints import Places


def simulated_calibration(scene: Scene, result: Simulated) -> Calibration:
    """Returns the calibration of a simulated room; its mask selects the directly lit camera pixels."""
    mask = directly_lit(result.transport, result.ambient, (scene.projector.height, scene.projector.width))
    if not mask.any():
        raise InputError(
            f"{scene.name}: the projector raises no camera pixel clearly above the ambient light; dim that"
        )
    return Calibration(
        name=scene.name,
        provenance=f"simulated from the scene {scene.name} by counterlight simulate",
        projectors=(Device(scene.projector.height, scene.projector.width, scene.projector.response),),
        camera=Device(scene.camera.height, scene.camera.width, Response("linear")),
        ambient=result.ambient,
        mask=mask,
        primaries=None if result.spectral is None else result.spectral.primaries,
    )


def simulated_room(scene: Scene, results: Sequence[Simulated]) -> tuple[Calibration, Transport]:
    """Returns the room of a scene's views, joined if there are several.

    results : one per view of `scene.views`.
    """
    rooms = [simulated_calibration(view, result) for view, result in zip(scene.views, results, strict=True)]
    if len(rooms) == 1:
        return rooms[0], results[0].transport
    exact = CameraOptions(keep_exposures=True)
    shared = joined_cameras(rooms, [result.transport for result in results], scene.name, exact)
    return replace(shared.calibration, provenance=rooms[0].provenance), shared.transport


def fill_simulated_room(scene: Scene, results: Sequence[Simulated], stage: Path) -> str:
    """Write a simulated scene into the stage of a calibration; returns a short description."""
    if scene.places is not None:
        return _fill_set(scene, scene.places, results, stage)
    room, transport = simulated_room(scene, results)
    write_transport(transport, stage)
    calibration.write(room, stage)
    entries, mask = transport.near.indices.size, room.mask
    several = f"{described(room)}, " if room.screen is not None else ""
    blurring = "" if results[0].blurring is None else f"; {results[0].blurring}"
    lit = f"{mask.sum()} of {mask.size} camera pixels in the mask"
    return f"{several}{entries} near entries a channel, {lit}{blurring}"


def _fill_set(scene: Scene, places: Places, results: Sequence[Simulated], stage: Path) -> str:
    rooms = [simulated_calibration(view, result) for view, result in zip(scene.views, results, strict=True)]
    exact = CameraOptions(keep_exposures=True)
    views, _ = on_shared_screen(rooms, [result.transport for result in results], scene.name, exact)
    views = [(replace(room, provenance=rooms[0].provenance), transport) for room, transport in views]
    write_views(views, places, stage)
    return joined_views.described(views)

"""From a simulated scene to a calibration folder."""

from pathlib import Path

from counterlight import calibration
from counterlight.calibration import Calibration, Device
from counterlight.errors import InputError
from counterlight.response import Response
from counterlight.tools.simulation.scene import Scene
from counterlight.tools.simulation.simulate import Simulated
from counterlight.tools.transport.mask import lit_pixels
from counterlight.tools.transport.storage import write_transport
from counterlight.tools.transport.transport import Transport


def write_simulated_room(scene: Scene, result: Simulated, folder: Path) -> None:
    """Write a simulated scene as a calibration folder, which must not be there."""
    with calibration.replacing(folder) as stage:
        fill_simulated_room(scene, result, stage)


def fill_simulated_room(scene: Scene, result: Simulated, stage: Path) -> str:
    """Write a simulated scene into the stage of a calibration; returns some words on the whole.

    The mask holds the camera pixels that the projector lights directly.
    """
    shape = scene.camera.height, scene.camera.width, 3
    direct = Transport(result.transport.near).composition().reshape(shape)
    mask = lit_pixels(direct, result.ambient)
    if not mask.any():
        raise InputError(
            f"{scene.name}: the projector raises no camera pixel clearly above the ambient light; dim that"
        )
    room = Calibration(
        name=scene.name,
        provenance=f"simulated from the scene {scene.name} by counterlight simulate",
        projectors=(Device(scene.projector.height, scene.projector.width, scene.projector.response),),
        camera=Device(scene.camera.height, scene.camera.width, Response("linear")),
        ambient=result.ambient,
        mask=mask,
    )
    write_transport(result.transport, stage)
    calibration.write(room, stage)
    entries = result.transport.near[0].nnz
    return f"{entries} near entries a channel, {mask.sum()} of {mask.size} camera pixels lit directly"

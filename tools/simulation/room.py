"""From a simulated scene to a calibration folder."""

from pathlib import Path

from counterlight import calibration
from counterlight.calibration import Calibration, Device
from counterlight.errors import InputError
from counterlight.response import Response
from counterlight.tools.simulation.scene import Scene
from counterlight.tools.simulation.simulate import Simulated
from counterlight.tools.transport.mask import directly_lit
from counterlight.tools.transport.storage import write_transport


def simulated_calibration(scene: Scene, result: Simulated) -> Calibration:
    """What a room says beside its transport; the mask holds the camera pixels that the projector lights directly."""
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


def fill_simulated_room(scene: Scene, result: Simulated, stage: Path) -> str:
    """Write a simulated scene into the stage of a calibration; returns some words on the whole."""
    room = simulated_calibration(scene, result)
    write_transport(result.transport, stage)
    calibration.write(room, stage)
    entries, mask = result.transport.near.indices.size, room.mask
    blurring = "" if result.blurring is None else f"; {result.blurring}"
    return f"{entries} near entries a channel, {mask.sum()} of {mask.size} camera pixels lit directly{blurring}"

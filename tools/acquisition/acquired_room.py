"""From an acquisition to a calibration folder."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from counterlight import calibration
from counterlight.calibration import Calibration, Device
from counterlight.errors import InputError
from counterlight.files.manifest import sha256_of
from counterlight.response import Response
from counterlight.tools.acquisition.acquire import Acquisition, acquire
from counterlight.tools.acquisition.cameras.camera import LINEAR, Camera
from counterlight.tools.acquisition.cameras.folder import FolderCamera
from counterlight.tools.acquisition.plan import MakeScheme
from counterlight.tools.acquisition.ramps import ProjectorLight
from counterlight.tools.acquisition.room_options import ASSUMED
from counterlight.tools.acquisition.store import CaptureStore, Wanted, open_store
from counterlight.tools.acquisition.summary import AcquisitionReport, LightOutside
from counterlight.tools.choices import TOLERANCE
from counterlight.tools.clusters.components import find_clusters
from counterlight.tools.colour.tiers import tier_of
from counterlight.tools.factoring.factoring import Factoring, factored
from counterlight.tools.solve.box import CHECK_EVERY, Box
from counterlight.tools.transport.mask import directly_lit
from counterlight.tools.transport.objective import DEFAULT_AIMS, objective_of
from counterlight.tools.transport.storage import write_transport
from counterlight.tools.transport.transport import Transport, luminance_matrix
from counterlight.tools.transport.trust import seen

MOST_TRIED = 1 << 17  # camera pixels up to which a white picture is tried; build tries it anyway


@dataclass(frozen=True)
class Plan:
    """What to acquire.

    scheme : its name, for the records.  projector : (height, width).  options : what else decides which pattern comes
    next.  response : of the projector, None for the measured one.  tolerance : dB that pictures may lose where a
    dense T is factored, 0 for T as it is.
    """

    scheme: str
    make_scheme: MakeScheme
    projector: tuple[int, int]
    options: dict[str, Any]
    response: Response | None = None
    tolerance: float = TOLERANCE


def acquire_room(
    camera: Camera, plan: Plan, captures: Path, wanted: Wanted, *, name: str | None = None
) -> AcquisitionReport:
    """Acquire and write the calibration `wanted.room`; it appears whole or not at all, the captures stay.

    captures : where they are kept; a run that was interrupted goes on with what is there.
    """
    folder = wanted.room
    with open_store(captures, _session(camera, plan), camera.exposures, wanted) as store:
        if isinstance(camera, FolderCamera):
            camera.bind(store.id, first=not store.replaces)
        with calibration.replacing(folder, force=wanted.anew) as stage:
            room, transport, done, factoring = _acquire(camera, plan, store, folder.name if name is None else name)
            write_transport(transport, stage)
            calibration.write(room, stage)
            store.made(sha256_of(stage / calibration.TOML))
        store.finish()
    return _report(done, room, transport, plan.response, factoring)


def _session(camera: Camera, plan: Plan) -> dict[str, Any]:
    """What captures are of."""
    return {
        "camera": camera.name,
        "scheme": plan.scheme,
        "projector": [plan.projector[1], plan.projector[0]],
        **plan.options,
    }


def _acquire(
    camera: Camera, plan: Plan, store: CaptureStore, name: str
) -> tuple[Calibration, Transport, Acquisition, Factoring]:
    done = acquire(camera, store, plan.make_scheme, plan.projector, plan.response)
    ambient = np.maximum(done.room.black, 0).astype(np.float32)
    shape = ambient.shape
    whole = replace(done.measured.transport, camera=shape[:2], projector=plan.projector)
    transport, factoring = factored(whole, ambient, plan.tolerance)
    mask = directly_lit(transport, ambient, plan.projector, done.room.rise_noise) & ~done.room.saturated
    if not mask.any():
        raise InputError(
            "no camera pixel is clearly lit by single projector pixels; lower --threshold, or darken the room"
        )
    response, source = _response(plan.response, done.light)
    room = Calibration(
        name,
        f"acquire-transport, scheme {plan.scheme}, {done.pictures} pictures, camera {camera.name}; response {source}",
        (Device(*plan.projector, response),),
        Device(shape[0], shape[1], LINEAR),
        ambient,
        mask,
        None if done.light is None else done.light.primaries,
    )
    return room, transport, done, factoring


def _response(given: Response | None, light: ProjectorLight | None) -> tuple[Response, str]:
    """The projector's response, and where it comes from."""
    if given is not None:
        return given, "given"
    return (light.response, light.fit) if light else (ASSUMED, "sRGB assumed")


def _report(
    done: Acquisition,
    room: Calibration,
    transport: Transport,
    given: Response | None,
    factoring: Factoring,
) -> AcquisitionReport:
    indices = transport.near.indices
    return AcquisitionReport(
        acquisition=done,
        given=given,
        covered=float(np.unique(indices).size / transport.shape[1]),
        lit=int(room.mask.sum()),
        camera_pixels=room.mask.size,
        entries=int(indices.size),
        clusters=find_clusters(luminance_matrix(transport.near)),
        factoring=factoring,
        outside=_light_outside(room, transport),
    )


def _light_outside(room: Calibration, transport: Transport) -> LightOutside:
    unseen = float(np.mean(np.maximum(1 - seen(transport, np.ones(transport.shape[0], np.bool_)), 0)))
    if room.camera.pixels > MOST_TRIED:
        return LightOutside(unseen, None)
    tier = tier_of(room, transport)
    objective = objective_of(tier.transport, room, DEFAULT_AIMS)
    white = tier.asked(np.full(tier.ambient.shape, tier.white)).reshape(-1, 3)
    drive, _ = Box(objective, most_steps=CHECK_EVERY).run(white)  # what nobody sees is dark after the first steps
    return LightOutside(unseen, objective.light_outside(drive))

"""From an acquisition to a calibration folder, and what a user should know of it."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from counterlight import calibration
from counterlight.calibration import Calibration, Device
from counterlight.errors import InputError
from counterlight.files.manifest import sha256_of
from counterlight.tools.acquisition.acquire import Acquisition, acquire
from counterlight.tools.acquisition.cameras.camera import LINEAR, Camera
from counterlight.tools.acquisition.cameras.folder import FolderCamera
from counterlight.tools.acquisition.plan import MakeScheme
from counterlight.tools.acquisition.store import CaptureStore, Wanted, open_store
from counterlight.tools.choices import TOLERANCE
from counterlight.tools.clusters.components import Clusters, find_clusters
from counterlight.tools.factoring.factoring import Factoring, factored
from counterlight.tools.transport.mask import directly_lit
from counterlight.tools.transport.storage import write_transport
from counterlight.tools.transport.transport import Transport, luminance_matrix

SUSPECT = 3.0  # times the camera's noise that the check may be off


@dataclass(frozen=True)
class AcquisitionReport:
    """What was acquired; its text is the command's output.

    covered : share of the projector's pixels that some camera pixel sees.  lit, camera_pixels : inside the mask, and in
    all.  entries : near light, of one channel.  factoring : what a dense T became.
    """

    acquisition: Acquisition
    covered: float
    lit: int
    camera_pixels: int
    entries: int
    clusters: Clusters
    factoring: Factoring

    def __str__(self) -> str:
        done = self.acquisition
        resumed = f", {done.resumed} of them from before" if done.resumed else ""
        sizes = self.clusters.projector_sizes
        noise = 100 * float(np.max(done.room.noise.dark)) / float(np.max(done.room.floodlight))
        lines = [
            *done.measured.notes,
            f"{done.pictures} pictures, {done.exposures} exposures{resumed}, {done.seconds:.1f} s; noise of a dark "
            f"capture {noise:.2g} % of the brightest",
            f"coverage: {100 * self.covered:.1f} % of the projector's pixels seen, {self.lit} of {self.camera_pixels} "
            "camera pixels lit",
            f"clusters: {self.clusters.count}, the largest of {sizes.max(initial=0)} projector pixels; {self.entries} "
            "near entries a channel",
            str(self.factoring),
            f"check: a random pattern is predicted to {100 * done.check_error:.1f} % (noise alone: "
            f"{100 * done.check_noise:.1f} %)",
        ]
        return "\n".join(lines)

    @property
    def suspect(self) -> bool:
        """The prediction is much worse than noise explains."""
        return self.acquisition.check_error > SUSPECT * self.acquisition.check_noise + 0.05


@dataclass(frozen=True)
class Plan:
    """What to acquire.

    scheme : its name, for the records.  options : what else decides which pattern comes next.  tolerance : dB that
    pictures may lose where a dense T is factored, 0 for T as it is.
    """

    scheme: str
    make_scheme: MakeScheme
    projector: Device
    options: dict[str, Any]
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
    return _report(done, room.mask.ravel(), transport, factoring)


def _session(camera: Camera, plan: Plan) -> dict[str, Any]:
    """What captures are of."""
    return {
        "camera": camera.name,
        "scheme": plan.scheme,
        "projector": [plan.projector.width, plan.projector.height],
        **plan.options,
    }


def _acquire(
    camera: Camera, plan: Plan, store: CaptureStore, name: str
) -> tuple[Calibration, Transport, Acquisition, Factoring]:
    done = acquire(camera, store, plan.make_scheme, plan.projector.shape)
    ambient = np.maximum(done.room.black, 0).astype(np.float32)
    shape = ambient.shape
    whole = replace(done.measured.transport, camera=shape[:2], projector=plan.projector.shape)
    transport, factoring = factored(whole, ambient, plan.tolerance)
    mask = directly_lit(transport, ambient) & ~done.room.saturated
    if not mask.any():
        raise InputError(
            "no camera pixel is clearly lit by single projector pixels; lower --threshold, or darken the room"
        )
    room = Calibration(
        name,
        f"acquire-transport, scheme {plan.scheme}, {done.pictures} pictures, camera {camera.name}",
        (plan.projector,),
        Device(shape[0], shape[1], LINEAR),
        ambient,
        mask,
    )
    return room, transport, done, factoring


def _report(
    done: Acquisition, mask: np.ndarray[Any, np.dtype[np.bool_]], transport: Transport, factoring: Factoring
) -> AcquisitionReport:
    indices = transport.near.indices
    return AcquisitionReport(
        acquisition=done,
        covered=float(np.unique(indices).size / transport.shape[1]),
        lit=int(mask.sum()),
        camera_pixels=mask.size,
        entries=int(indices.size),
        clusters=find_clusters(luminance_matrix(transport.near)),
        factoring=factoring,
    )

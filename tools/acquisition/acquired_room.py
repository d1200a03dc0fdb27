"""Write the calibration folder of an acquisition."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from counterlight import calibration
from counterlight.arrays import BoolArray, FloatArray
from counterlight.calibration import Calibration, Device
from counterlight.errors import InputError
from counterlight.files.manifest import sha256_of
from counterlight.raster import Shape, Shapes
from counterlight.response import Response
from counterlight.screen import parts_of
from counterlight.tools.acquisition.acquire import DEFAULT_AIM, Acquisition, acquire
from counterlight.tools.acquisition.averaging import Aim
from counterlight.tools.acquisition.cameras.camera import Camera
from counterlight.tools.acquisition.cameras.folder import FolderCamera
from counterlight.tools.acquisition.cameras.together import views_of
from counterlight.tools.acquisition.few.acquire import acquire_pictures
from counterlight.tools.acquisition.plan import MakeScheme
from counterlight.tools.acquisition.ramps import ProjectorLight
from counterlight.tools.acquisition.room_options import ASSUMED
from counterlight.tools.acquisition.store import CaptureStore, Wanted, open_store
from counterlight.tools.acquisition.summary import AcquisitionReport, Black, Coverage, LightOutside, ProjectorReport
from counterlight.tools.choices import TOLERANCE
from counterlight.tools.clusters.components import find_clusters
from counterlight.tools.colour.tiers import tier_of
from counterlight.tools.factoring.factoring import Factoring, compacted, factored
from counterlight.tools.joining.projectors import colour_lines, joined, with_monitors
from counterlight.tools.joining.shared_screen import SharedRoom, on_one_screen
from counterlight.tools.solve.box import CHECK_EVERY, Box
from counterlight.tools.transport.interval import (
    Expected,
    Interval,
    expected_quality,
    fit_interval,
    write_interval,
)
from counterlight.tools.transport.mask import directly_lit
from counterlight.tools.transport.objective import DEFAULT_AIMS, objective_of
from counterlight.tools.transport.storage import write_transport
from counterlight.tools.transport.transport import Transport, luminance_matrix
from counterlight.tools.transport.trust import seen

MOST_OF_BLACK = 1, 99  # percentiles of black, between which single hot pixels do not count
MOST_NOISE = 0.9  # largest share of the checks' squared error that may be noise; the noise is only known to a tenth
MOST_TRIED = 1 << 17  # camera pixels up to which a white picture is tried here; the build always tries it


@dataclass(frozen=True)
class Plan:
    """The settings of an acquisition.

    scheme : name of the scheme, for the records.
    projectors : (height, width) of each.
    options : further settings that decide which pattern comes next.
    response : response of the projectors; None for the measured response.
    tolerance : dB that pictures may lose when a dense T is factored; 0 keeps T unfactored.
    monitors : monitor names of several projectors; empty if not given.
    pictures : number of pictures if few/ acquires from pictures; `make_scheme` is then None.
    aim : noise allowed in T; None if each picture is captured once.
    """

    scheme: str
    make_scheme: MakeScheme | None
    projectors: Shapes
    options: dict[str, Any]
    response: Response | None = None
    tolerance: float = TOLERANCE
    monitors: tuple[str, ...] = ()
    pictures: int = 0
    aim: Aim | None = None


def acquire_room(
    camera: Camera, plan: Plan, captures: Path, wanted: Wanted, *, name: str | None = None
) -> AcquisitionReport:
    """Acquire and write the calibration `wanted.room`; the folder appears whole or not at all, and the captures stay.

    captures : folder of the captures; an interrupted run continues with the captures in it.
    """
    folder = wanted.room
    with open_store(captures, _session(camera, plan), camera.exposures, wanted) as store:
        if isinstance(camera, FolderCamera):
            camera.bind(store.id, first=not store.replaces)
        with calibration.replacing(folder, force=wanted.anew) as stage:
            parts = _acquire(camera, plan, store, folder.name if name is None else name)
            found = _together(parts, plan.monitors, views_of(camera))
            room, transport = found.calibration, found.transport
            write_transport(transport, stage)
            judged = _judged(parts, found)
            if judged is not None:
                write_interval(judged[0], stage)
            calibration.write(room, stage)
            store.made(sha256_of(stage / calibration.TOML))
        store.finish()
    return _report(parts, found, plan.response, None if judged is None else judged[1])


def _session(camera: Camera, plan: Plan) -> dict[str, Any]:
    """Returns the settings that identify a set of captures."""
    sizes = [[width, height] for height, width in plan.projectors]
    shown = {"projector": sizes[0]} if len(sizes) == 1 else {"projectors": sizes}
    averaged = {"repeats": list[int]()} if plan.aim else {}
    return {"camera": camera.name, "scheme": plan.scheme, **shown, **plan.options, **averaged}


@dataclass(frozen=True)
class _Part:
    """One projector's room, its transport, and the acquisition that gave both."""

    room: Calibration
    transport: Transport
    done: Acquisition
    factoring: Factoring


def _acquire(camera: Camera, plan: Plan, store: CaptureStore, name: str) -> list[_Part]:
    if plan.make_scheme is None:
        found = acquire_pictures(camera, store, plan.pictures, plan.projectors, plan.response)
    else:
        found = acquire(camera, store, plan.make_scheme, plan.projectors, plan.response, plan.aim or DEFAULT_AIM)
    return [_part(done, shape, camera, plan, name) for done, shape in zip(found, plan.projectors, strict=True)]


def _part(done: Acquisition, projector: Shape, camera: Camera, plan: Plan, name: str) -> _Part:
    ambient = np.maximum(done.room.black, 0).astype(np.float32)
    shape = ambient.shape
    whole = replace(done.measured.transport, camera=shape[:2], projector=projector)
    cameras = views_of(camera)
    made_small = factored if cameras else compacted  # compacting in blocks handles only a single camera
    transport, factoring = made_small(whole, ambient, plan.tolerance)
    mask = _lit(transport, ambient, projector, done.room.rise_noise, cameras) & ~done.room.saturated
    if not mask.any():
        raise InputError(
            "no camera pixel is clearly lit by single projector pixels; lower --threshold, or darken the room"
        )
    response, source = _response(plan.response, done.light)
    room = Calibration(
        name,
        f"acquire-transport, scheme {plan.scheme}, {done.pictures} pictures, camera {camera.name}; response {source}",
        (Device(*projector, response),),
        Device(shape[0], shape[1], done.curve.response if done.curve else camera.exposures.response),
        ambient,
        mask,
        None if done.light is None else done.light.primaries,
    )
    return _Part(room, transport, done, factoring)


def _together(parts: Sequence[_Part], monitors: Sequence[str], cameras: Shapes) -> SharedRoom:
    """Join the rooms of all projectors; `cameras` is the (height, width) of each if there are several."""
    room, transport = parts[0].room, parts[0].transport
    if len(parts) > 1:
        names = [f"projector {number}" for number in range(1, len(parts) + 1)]
        room, transport = joined([part.room for part in parts], [part.transport for part in parts], names)
        provenances = "; ".join(f"{name}: {part.room.provenance}" for name, part in zip(names, parts, strict=True))
        room = replace(room, provenance=provenances, projectors=with_monitors(room.projectors, monitors))
    return on_one_screen(room, transport, cameras) if cameras else SharedRoom(room, transport)


def _lit(
    transport: Transport,
    ambient: NDArray[np.float32],
    projector: Shape,
    noise: FloatArray | None,
    cameras: Shapes,
) -> BoolArray:
    """Returns the lit camera pixels, found per camera, because a pixel's neighbours must lie in the same picture."""
    if not cameras:
        return directly_lit(transport, ambient, projector, noise)
    pixels = np.arange(transport.shape[0]).reshape(ambient.shape[:2])
    mask = np.zeros(pixels.shape, bool)
    for view in parts_of(cameras):
        mask[view] = directly_lit(transport.at(pixels[view].ravel()), ambient[view], projector, noise)
    return mask


def _judged(parts: Sequence[_Part], found: SharedRoom) -> tuple[Interval, Expected] | None:
    """Fit a prediction interval to each projector's checks, which no fit has seen, and judge the room.

    The interval is for light in the screen's primaries. Returns None without such pictures.
    """
    room, tier, pairs, noise = found.calibration, tier_of(found.calibration, found.transport), [], []
    spread = np.zeros(3)
    for part in parts:
        for check in part.done.photographs or (part.done.check, part.done.coloured):
            if check is None or check.lights is None:
                continue
            lights = check.lights.reshape(2, -1, *room.ambient.shape) + part.done.room.black
            for view, gain in zip(room.views, room.gains, strict=True):
                lights[:, :, *view] *= gain
            pairs.append(tier.mixing.on_screen(lights))
            noise.append(min((check.noise / max(check.error, 1e-12)) ** 2, MOST_NOISE))
        if part.done.wander is not None:
            spread = np.maximum(spread, part.done.wander.spread)
    if not pairs:
        return None
    predicted, captured = np.concatenate(pairs, axis=1)
    of_screen = np.sqrt(tier.mixing.on_screen(np.eye(3)).T ** 2 @ spread**2)
    # a prediction is scaled by the gain of its capture
    interval = fit_interval(predicted, captured, room.mask, of_screen)
    return interval, expected_quality(interval, predicted, captured, room.mask, tier.white, float(np.mean(noise)))


def _response(given: Response | None, light: ProjectorLight | None) -> tuple[Response, str]:
    """Returns the projector's response and a word for its source."""
    if given is not None:
        return light.curve(given) if light else given, "given"
    return (light.response, light.fit) if light else (ASSUMED, "sRGB assumed")


def _report(
    parts: Sequence[_Part], found: SharedRoom, given: Response | None, expected: Expected | None
) -> AcquisitionReport:
    room, transport = found.calibration, found.transport
    indices = transport.near.indices
    return AcquisitionReport(
        projectors=tuple(ProjectorReport(part.done, given, part.factoring, _coverage(part)) for part in parts),
        masked=int(room.mask.sum()),
        camera_pixels=room.mask.size,
        entries=int(indices.size),
        clusters=find_clusters(luminance_matrix(transport.near)),
        outside=_light_outside(room, transport),
        black=_black(room, transport) if len(parts) > 1 else None,
        colours=tuple(colour_lines(room.projectors)),
        placed=found.placed,
        expected=expected,
    )


def _coverage(part: _Part) -> Coverage:
    return Coverage(part.transport.lit.any(axis=1).reshape(part.room.projector.shape))


def _black(room: Calibration, transport: Transport) -> Black:
    """Returns percentiles of the captured black: the room's light and the black levels of all projectors."""
    tier = tier_of(room, transport)
    seen = np.max(tier.ambient[room.mask], axis=-1) / tier.white
    return Black(*(float(np.percentile(seen, share)) for share in MOST_OF_BLACK))


def _light_outside(room: Calibration, transport: Transport) -> LightOutside:
    unseen = float(np.mean(np.maximum(1 - seen(transport, np.ones(transport.shape[0], np.bool_)), 0)))
    if room.camera.pixels > MOST_TRIED:
        return LightOutside(unseen, None)
    tier = tier_of(room, transport)
    objective = objective_of(tier.transport, room, DEFAULT_AIMS, tier.mixing)
    white = tier.target(np.full(tier.ambient.shape, tier.white)).reshape(-1, 3)
    drive, _ = Box(objective, most_steps=CHECK_EVERY).run(white)  # unseen pixels are dark after the first steps
    return LightOutside(unseen, objective.light_outside(drive))

"""Builds maps from a room in memory (invert, remove far light, pack), and from a calibration folder."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy import ndimage

from counterlight.calibration import Calibration, StoredCalibration
from counterlight.jobs.workers import Workers
from counterlight.maps import room_maps as maps
from counterlight.maps.room_maps import MapChain, RefinementMaps, RoomMaps
from counterlight.maps.row_map import RowMap, pack, unpack
from counterlight.raster import Region
from counterlight.tools.colour.tiers import Tier, tier_of
from counterlight.tools.inverse import memory
from counterlight.tools.inverse.far_light import undo_far_light
from counterlight.tools.inverse.near_light import (
    Conditions,
    Inverse,
    InverseOptions,
    invert_as_the_thesis,
    invert_near_light,
    mapped_directly,
)
from counterlight.tools.inverse.pictures import pictures_of
from counterlight.tools.inverse.recommendation import AS_THE_THESIS, Recommendation, recommended
from counterlight.tools.inverse.refinement_maps import pack_chain, refinement_maps
from counterlight.tools.inverse.super_blocks import Elsewhere
from counterlight.tools.inverse.words_light import words_of
from counterlight.tools.transport.interval import read_interval
from counterlight.tools.transport.objective import DEFAULT_AIMS, Objective, ObjectiveOptions, objective_of, owners
from counterlight.tools.transport.storage import read_transport
from counterlight.tools.transport.transport import Transport

RESOLVED = 0.9  # camera pixels per projector pixel, below which a camera counts as coarser than the projector
CHOSEN = {
    "whole": "the whole T⁺",
    "cut": "T⁺ cut into clusters",
    "none": "no T⁺, direct mapping",
    "thesis": "T⁺ as the thesis computes it",
}
STARTED = {"previous": "it", "previous-direct": "direct mapping"}


@dataclass(frozen=True)
class BuiltRoom:
    """A room in its colour tier, its inverse and its maps; `summary` is one line.

    light_outside : for a white picture, light that the camera does not see, relative to plain projection; None if plain
        projection has none.
    recommendation : the best way to play the room; None without refinement.
    """

    tier: Tier
    inverse: Inverse
    maps: RoomMaps
    summary: str
    light_outside: float | None
    recommendation: Recommendation | None = None

    @property
    def calibration(self) -> Calibration:
        return self.tier.calibration

    @property
    def transport(self) -> Transport:
        """The transport that was inverted."""
        return self.tier.transport

    @property
    def coarseness(self) -> str | None:
        """A warning if the camera resolves fewer pixels than the projector pixels that it sees; None otherwise."""
        camera, projector = int(np.count_nonzero(self.calibration.mask)), int(self.transport.lit.any(axis=1).sum())
        if camera >= RESOLVED * projector:
            return None
        return (
            f"warning: {camera} camera pixels see {projector} projector pixels: details that are finer than a camera "
            "pixel stay as they are; use a camera of more pixels, a longer lens, or a nearer place"
        )

    @property
    def conclusion(self) -> str:
        """The chosen inverse with its reason, size and quality, for the last line of a build."""
        inverse, packed = self.inverse, self.maps
        mib = sum(m.nbytes for m in packed.named().values()) / 2**20
        reason = f" ({inverse.reason})" if inverse.reason else ""
        words = f"{CHOSEN[inverse.chosen]}{reason}, {_kept(inverse)}{mib:.0f} MiB of maps"
        found = self.recommendation
        if found is None:
            return words
        if not found.steps:
            return f"{words}; play makes no step"
        return (
            f"{words}; in simulation {found.after(0):.1f} dB below the optimum without a step, "
            f"{found.after(found.steps):.2f} after the {found.steps} that play makes from {STARTED[found.start]}, of "
            f"which priors cost {found.priors:.2f}"
        )


def build_room_maps(
    stored: StoredCalibration,
    options: InverseOptions,
    aims: ObjectiveOptions = DEFAULT_AIMS,
    *,
    refine: bool = True,
    colour: str = "auto",
    workers: Workers | None = None,
) -> BuiltRoom:
    """Build and write every row map of a calibration.

    refine : whether to include the maps of refinement.
    colour : one of choices.COLOURS.
    workers : processes, also on other machines, that invert windows; None for this process.

    Raises InputError at once if another process is building the maps.
    """
    with maps.replacing(stored) as stage:
        transport = read_transport(stored)
        pixels = stored.calibration.camera.pixels + stored.calibration.projector.pixels
        near = transport.near.indices.size
        memory.check_room(near, transport.entries - near, pixels)
        tier = tier_of(stored.calibration, transport, colour)
        with TemporaryDirectory(dir=stage) as shared:
            elsewhere = None if workers is None else Elsewhere(workers, Path(shared).absolute())
            built = build_maps(tier, options, aims, refine=refine, elsewhere=elsewhere)
        if (interval := read_interval(stored)) is not None:
            black = built.maps.mixing.on_screen(stored.calibration.ambient)
            lights = {"black": black, "white": np.full_like(black, built.maps.white)}
            typical = {name: interval.typical(light, stored.calibration.mask) for name, light in lights.items()}
            built = replace(built, maps=replace(built.maps, details=built.maps.details | {"interval": typical}))
        maps.write_maps(built.maps, stored, stage)
    return built


def build_maps(
    tier: Tier,
    options: InverseOptions,
    aims: ObjectiveOptions = DEFAULT_AIMS,
    *,
    refine: bool = True,
    elsewhere: Elsewhere | None = None,
    entry_bytes: float = memory.ENTRY_BYTES,
) -> BuiltRoom:
    """Build every row map of a room in memory. No files are read or written, except for work on other machines.

    entry_bytes : memory that an entry of T⁺ takes, including later stages.

    Raises InputError for a room that cannot be inverted.
    """
    transport, calibration, white, options = tier.transport, tier.calibration, tier.white, options.settled
    camera, projector = calibration.camera.shape, calibration.projector.shape
    maps.check_white(white)
    reach = np.asarray(tier.mixing.brightest(white, tier.ambient), np.float64).reshape(-1, 3)
    objective = objective_of(tier.transport, tier.calibration, aims, tier.mixing)
    common = projector, reach, white, options
    if options.inverse == "thesis":
        inverse = invert_as_the_thesis(transport, camera, *common)
    elif transport.blurred is not None:
        inverse = mapped_directly(objective, options)
    else:
        mask = (objective.weights > 0).reshape(camera)
        conditions = calibration.regions, objective.weights, objective.prior, pictures_of(calibration)
        inverse = invert_near_light(transport.near, mask, *common, Conditions(*conditions, elsewhere, entry_bytes))
    if aims.outside == "continue" and inverse.chosen != "thesis":
        inverse = continued(inverse, projector, calibration.regions)
    correction = pack(inverse.T_pinv, projector, camera)
    far, undo = _pack_far_light(transport, inverse, camera, projector)
    details = _details(inverse, correction, transport, options, aims)
    further = refinement_maps(objective, camera, projector) if refine else None
    observe = pack(transport.near, camera, projector)
    blurred = pack_chain(transport.blurred, camera, projector)
    bounded = inverse.chosen != "thesis"
    light, lit = (correction, observe, far, undo), objective.lit_picture(calibration)
    packed = RoomMaps(*light, white, details, further, tier.mixing, bounded, blurred=blurred, lit=lit)
    outside = _light_outside(objective, inverse, tier)
    found = None
    if further is not None:
        found = _recommended(objective, inverse, packed, further, calibration)
        packed = replace(packed, details=details | found.to_toml())
    del objective  # the transport of `objective` takes as much memory as the words
    packed = replace(packed, words=words_of(packed, options.max_error))
    return BuiltRoom(tier, inverse, packed, _summary(inverse, packed, outside), outside, found)


def _recommended(
    objective: Objective, inverse: Inverse, packed: RoomMaps, further: RefinementMaps, calibration: Calibration
) -> Recommendation:
    if inverse.chosen == "thesis":
        return AS_THE_THESIS
    direct, T_pinv = unpack(further.direct), None if inverse.chosen == "none" else inverse.T_pinv
    return recommended(objective, direct, T_pinv, packed.white, calibration.camera.shape, pictures_of(calibration))


def _light_outside(objective: Objective, inverse: Inverse, tier: Tier) -> float | None:
    white = objective.bounded(tier.target(np.full(tier.ambient.shape, tier.white)).reshape(-1, 3))
    return objective.light_outside(np.clip(inverse.T_pinv.apply(white), 0, 1))


def _pack_far_light(
    transport: Transport, inverse: Inverse, camera: tuple[int, int], projector: tuple[int, int]
) -> tuple[MapChain | None, MapChain | None]:
    far = pack_chain(transport.far, camera, projector)
    if transport.far is None or far is None or inverse.chosen == "thesis":
        return far, None
    return far, pack_chain(undo_far_light(transport.far, inverse.T_pinv), camera, camera, far.scatter)


def _details(
    inverse: Inverse, correction: RowMap, transport: Transport, options: InverseOptions, aims: ObjectiveOptions
) -> dict[str, Any]:
    """Return the manifest's entries besides the maps: options, results, and the bounds that hold."""
    camera_bound = transport.apply(inverse.truncation)
    lengths = correction.lookup[..., 2]
    return {
        "options": {
            "regularize": "auto" if options.damping is None else options.damping,
            "max_error_codes": options.max_error,
            "inverse": options.inverse,
            **({} if options.tau is None else {"tau": options.tau}),
            "noise": options.noise,
            **asdict(aims),
            **({} if options.max_cluster is None else {"max_cluster": options.max_cluster}),
        },
        **_decomposition(inverse),
        "inverse": {
            "damping": inverse.damping,
            "damping_errors": {f"{key:g}": value for key, value in inverse.damping_errors.items()},
            "chosen": inverse.chosen,
            "reason": inverse.reason,
            "clusters": inverse.clusters.count,
            "largest_cluster": list(inverse.largest_cluster),
            "method": inverse.method.name,
            "method_reason": inverse.method.reason,
            "windowed_clusters": inverse.windowed_clusters,
            **_windows(inverse),
            "longest_row": int(lengths.max()),
        },
        "certified": {
            "truncation_drive": float(inverse.truncation.max(initial=0.0)),
            "truncation_camera_radiance": float(camera_bound.max(initial=0.0)),
            "holds_for": "light handed to T⁺ (far light taken out) of at most white, or the ambient light if brighter",
        },
    }


def _windows(inverse: Inverse) -> dict[str, Any]:
    if not inverse.halos.size:
        return {}
    halos, counts = np.unique(inverse.halos, return_counts=True)
    return {
        "window_halos": {str(halo): int(count) for halo, count in zip(halos, counts, strict=True)},
        "window_residual": float(inverse.residual.max()),
        "window_residual_meaning": "change of a pixel, times the largest drive that the exact inverse asks for nearby",
    }


def _decomposition(inverse: Inverse) -> dict[str, Any]:
    if inverse.decomposition is None:
        return {}
    parameters, report = inverse.decomposition
    return {"decomposition": asdict(parameters) | asdict(report)}


def _kept(inverse: Inverse) -> str:
    """Return how many connections the thesis' method has kept, in words."""
    if inverse.tau is None or inverse.decomposition is None:
        return ""
    parameters, report = inverse.decomposition
    return (
        f"{report.connections_before} connections above τ {inverse.tau:g} of white cut to {report.connections_after} "
        f"(radius {parameters.radius:g}, τ₁ {parameters.tau_1:.3g}), "
    )


def _summary(inverse: Inverse, packed: RoomMaps, outside: float | None) -> str:
    clusters, correction = inverse.clusters, packed.correction
    texture = f"{correction.entries.shape[1]}x{correction.entries.shape[0]}"
    stray = "" if outside is None else f", light outside {100 * outside:.0f} % of plain projection's"
    chosen = " (auto)" if inverse.damping_errors else ""
    cut, doubt, inverted = "", "", ""
    worst = float(inverse.residual.max(initial=0.0))
    if worst > inverse.window_tolerance:
        doubt = f"windows leave a residual of {255 * worst:.1f} code values (more damping lets them do), "
    if inverse.decomposition is not None:
        parameters, report = inverse.decomposition
        kept = 100 * report.connections_after / report.connections_before
        cut = f"cut to {kept:.0f} % of the connections (radius {parameters.radius:g}, τ₁ {parameters.tau_1:g}), "
    if clusters.count:
        inverted = (
            f"{clusters.count} clusters, largest {inverse.largest_cluster[0]} camera x {inverse.largest_cluster[1]} "
            f"projector pixels, {inverse.method}, λ {inverse.damping:g} σ₁{chosen}, "
        )
    if packed.blurred is not None:
        inverted = f"{packed.transport.count} near and {packed.blurred.scatter.count} blurred entries of T, "
    return (
        f"{cut}{inverted}{doubt}{correction.count} entries, texture {texture}, fill {100 * correction.fill:.1f} %, "
        f"{sum(m.nbytes for m in packed.named().values()) / 2**20:.1f} MiB of maps{stray}"
    )


def continued(inverse: Inverse, projector: tuple[int, int], regions: Sequence[Region]) -> Inverse:
    """Give each unseen pixel the row of its projector's nearest seen pixel (`--outside continue`).

    Refinement with ties to neighbours then makes the result smooth.

    projector : (height, width) of the raster.
    """
    owner, seen = owners(projector, regions), (inverse.T_pinv.lengths > 0).reshape(projector)
    source = np.arange(owner.size).reshape(projector)
    for number in range(int(owner.max()) + 1):
        known, lost = (owner == number) & seen, (owner == number) & ~seen
        if known.any():
            y, x = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
            source[lost] = (y * projector[1] + x)[lost]
    rows = source.ravel()
    return replace(inverse, T_pinv=inverse.T_pinv.at(rows), truncation=inverse.truncation[rows])

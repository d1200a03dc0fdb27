"""Joins projectors that were measured one at a time, side by side: their transports, ambient light and masks.

With p = (p₁, p₂, …) the pictures in one raster, T p = Σ T_k p_k: the columns of T_k move to the raster positions of
their pixels. For far light, M is block-diagonal, the D are stacked below each other, and the U stand next to each
other. P and B of blurred light are joined like D and U. Cells of the same surfaces, as in simulated rooms, are shared:
U M (D₁ p₁ + D₂ p₂).
"""

from collections.abc import Sequence
from dataclasses import fields, replace
from functools import reduce
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from counterlight import calibration as calibrations
from counterlight.arrays import FloatArray
from counterlight.calibration import Calibration, Device, StoredCalibration
from counterlight.errors import InputError
from counterlight.maps.chain import Chain
from counterlight.maps.row_map import SparseRows, below_each_other, next_to_each_other
from counterlight.passes.colour import LUMINANCE
from counterlight.pipeline.content import BRIGHT_PERCENTILE
from counterlight.raster import Region, side_by_side
from counterlight.tools.choices import TOLERANCE
from counterlight.tools.colour.shared import colour_matrices
from counterlight.tools.factoring.factoring import Factoring, factored
from counterlight.tools.transport.mask import FRACTION_OF_AMBIENT
from counterlight.tools.transport.storage import read_transport, write_transport
from counterlight.tools.transport.transport import Dense, Factor, M, Transport

# Share of the brightest floodlit pixels: a display's black level, which only some measurements include.
FRACTION_OF_BRIGHT = 0.005


def join_rooms(
    folders: Sequence[Path],
    output: Path,
    monitors: Sequence[str] = (),
    *,
    name: str | None = None,
    force: bool = False,
    tolerance: float = TOLERANCE,
) -> str:
    """Write one calibration from several calibrations of the same camera; returns a summary, and a line per dense T.

    monitors : one name per projector, in the order of the folders; empty to keep the folders' names.
    tolerance : dB that pictures may lose if a dense T is factored; 0 keeps T.

    Raises InputError for cameras of different sizes, and for differing ambient light.
    """
    if len(folders) < 2:
        raise InputError(f"{len(folders)} calibration to join: give at least two, of one projector each")
    with calibrations.replacing(output, force=force, inputs=folders) as stage:
        joint, transport, difference, factorings = _join(folders, monitors, name or output.name, tolerance)
        write_transport(transport, stage)
        calibrations.write(joint, stage)
    raster = f"raster {joint.projector.width}x{joint.projector.height}"
    lines = [
        f"{output}: {len(joint.projectors)} projectors, {raster}, ambient light differs by {100 * difference:.2g} % of "
        "white",
        *colour_lines(joint.projectors),
        *(f"{folder}: {done}" for folder, done in zip(folders, factorings, strict=True) if done.losses),
    ]
    return "\n".join(lines)


def colour_lines(projectors: Sequence[Device]) -> list[str]:
    """Return a line per projector whose primaries differ from the shared ones."""
    return [
        f"projector {number}: shows the primaries that all share by up to "
        f"{100 * (1 - np.diag(each.colour).min()):.0f} % of another of its own"
        for number, each in enumerate(projectors, 1)
        if each.colour is not None
    ]


def _join(
    folders: Sequence[Path], monitors: Sequence[str], name: str, tolerance: float
) -> tuple[Calibration, Transport, float, tuple[Factoring, ...]]:
    """Return the joint calibration, its transport, the difference of ambient light (share of white), and factorings."""
    stored = [calibrations.read(folder) for folder in folders]
    rooms = [one.calibration for one in stored]
    _check_cameras(stored)
    made = [factored(read_transport(one), one.calibration.ambient, tolerance) for one in stored]
    provenance = "joined by counterlight join: " + "; ".join(f"{room.name} ({room.provenance})" for room in rooms)
    parts = joined(rooms, [each for each, _ in made], [f"{one.folder}" for one in stored])
    joint = replace(parts[0], name=name, provenance=provenance, projectors=with_monitors(parts[0].projectors, monitors))
    return joint, parts[1], _check_ambient(stored, parts[1].composition()), tuple(done for _, done in made)


def joined(
    rooms: Sequence[Calibration], transports: Sequence[Transport], names: Sequence[str]
) -> tuple[Calibration, Transport]:
    """Join rooms of one camera; name and ambient light come from the first.

    names : names of the rooms, for error messages.

    Raises InputError for projectors that have no white in common.
    """
    colours, primaries = _join_colours(rooms, names)
    devices = [_turned(device, D) for room, D in zip(rooms, colours, strict=True) for device in room.projectors]
    mask = np.any([room.mask for room in rooms], axis=0)
    joint = replace(rooms[0], projectors=tuple(devices), mask=mask, primaries=primaries)
    return joint, join_transports(transports, [room.projector.shape for room in rooms])


def _join_colours(
    rooms: Sequence[Calibration], names: Sequence[str]
) -> tuple[tuple[FloatArray | None, ...], NDArray[np.float32] | None]:
    """Return each room's colour matrix, and the light of the shared primaries of all rooms together.

    Both are None unless the primaries of all rooms were measured.
    """
    found = [room.primaries for room in rooms if room.primaries is not None]
    if len(found) < len(rooms):
        return (None,) * len(rooms), None
    colours = colour_matrices(found, [room.mask for room in rooms], names)
    shown = [
        light if D is None else np.einsum("ml,mhwk->lhwk", D, light) for light, D in zip(found, colours, strict=True)
    ]
    return colours, np.sum(shown, axis=0).astype(np.float32)


def _turned(projector: Device, D: FloatArray | None) -> Device:
    """Return a projector that shows the shared primaries: D maps them to its own."""
    if D is None:
        return projector
    turned = D if projector.colour is None else np.array(projector.colour) @ D
    return replace(projector, colour=tuple(tuple(float(value) for value in row) for row in turned))


def join_transports(transports: Sequence[Transport], shapes: Sequence[tuple[int, int]]) -> Transport:
    """Return T of projectors side by side, from the left, aligned at the top of a raster as high as the highest.

    shapes : (height, width) of each projector.
    """
    (height, width), regions = side_by_side(shapes)
    places = [_places(region, width) for region in regions]
    near = _moved([transport.near for transport in transports], places, height * width)
    far = _join_chains([transport.far for transport in transports], places, height * width)
    blurred = _join_chains([transport.blurred for transport in transports], places, height * width)
    return Transport(near, far, transports[0].camera, (height, width), blurred)


def _places(region: Region, width: int) -> NDArray[np.int32]:
    """Return the index of each pixel of a region in a raster of `width` columns, (pixels,)."""
    rows, columns = np.mgrid[region.part]
    return np.asarray((rows * width + columns).ravel(), np.int32)


def _moved(parts: Sequence[SparseRows], places: Sequence[NDArray[np.int32]], columns: int) -> SparseRows:
    """Return the sum of matrices whose column j moves to places[j] of `columns`; no two share a place."""
    wide, at = reduce(next_to_each_other, parts), np.concatenate(places)
    return replace(wide, indices=at[wide.indices], columns=columns).ascending()


def _join_chains(
    chains: Sequence[Chain[SparseRows, M] | None], places: Sequence[NDArray[np.int32]], columns: int
) -> Chain[SparseRows, M] | None:
    """Join the cells of all projectors, shared cells once.

    places : each projector's pixel indices in the raster.
    """
    # cells that differ, and every projector's D for them
    found: list[tuple[Chain[SparseRows, M], list[SparseRows], list[NDArray[np.int32]]]] = []
    for chain, at in zip(chains, places, strict=True):
        if chain is not None:
            same = next((each for each in found if _same_cells(chain, each[0])), (chain, [], []))
            if not same[1]:
                found.append(same)
            same[1].append(chain.gather)
            same[2].append(at)
    if not found:
        return None
    gather = below_each_other([_moved(gathers, at, columns) for _, gathers, at in found])
    scatter = reduce(next_to_each_other, (chain.scatter for chain, _, _ in found))
    first = found[0][0]
    return Chain(gather, None if first.mix is None else block_diagonal([chain.mix for chain, _, _ in found]), scatter)


def block_diagonal(mixes: Sequence[Dense]) -> Dense:
    """Return M of separate cells."""
    matrices = zip(*(mix.matrices for mix in mixes), strict=True)
    return Dense(np.stack([sparse.block_diag(each).toarray() for each in matrices]))


def _same_cells(chain: Chain[Factor, Factor | None], other: Chain[Factor, Factor | None]) -> bool:
    """Return whether the factors after the cells are the same for two projectors."""
    return all(equal(*pair) for pair in zip(chain.factors[1:], other.factors[1:], strict=True))


def equal(one: Factor, other: Factor) -> bool:
    """Return whether two matrices have the same entries, in the same order."""
    return all(np.array_equal(getattr(one, each.name), getattr(other, each.name)) for each in fields(one))


def _check_cameras(stored: Sequence[StoredCalibration]) -> None:
    first = stored[0]
    several = next((one.folder for one in stored if one.calibration.screen is not None), None)
    if several is not None:
        raise InputError(
            f"{several}: has several cameras; join the projectors that each camera saw, then these rooms with --cameras"
        )
    for other in stored[1:]:
        if other.calibration.camera.shape != first.calibration.camera.shape:
            sizes = [f"{c.width}x{c.height}" for c in (other.calibration.camera, first.calibration.camera)]
            raise InputError(
                f"{other.folder}: its camera has {sizes[0]} pixels, that of {first.folder} {sizes[1]}; "
                "measure all projectors with one camera in one place, or add "
                "--cameras if several cameras saw the same projectors"
            )


def with_monitors(projectors: Sequence[Device], monitors: Sequence[str]) -> tuple[Device, ...]:
    """Return the projectors with monitor names, one per projector; unchanged without names."""
    if not monitors:
        return tuple(projectors)
    if len(monitors) != len(projectors):
        raise InputError(
            f"--monitor: {len(monitors)} given for {len(projectors)} projectors; give one for each, or none"
        )
    return tuple(replace(device, monitor=monitor) for device, monitor in zip(projectors, monitors, strict=True))


def _check_ambient(stored: Sequence[StoredCalibration], composition: NDArray[np.float64]) -> float:
    """Return the largest difference of ambient light as a share of white; raises InputError above the noise.

    The difference is the root mean square of luminance over the view. The limit is FRACTION_OF_AMBIENT of the ambient
    light, or FRACTION_OF_BRIGHT of the brightest floodlit pixels.
    """
    ambient = [one.calibration.ambient.astype(np.float64) @ LUMINANCE for one in stored]
    bright = float(np.percentile(composition @ LUMINANCE, BRIGHT_PERCENTILE))
    noise = max(FRACTION_OF_AMBIENT * _rms(ambient[0]), FRACTION_OF_BRIGHT * bright)
    differences = [_rms(other - ambient[0]) for other in ambient]
    worst = int(np.argmax(differences))
    if differences[worst] > noise:
        raise InputError(
            f"{stored[worst].folder}: its ambient light differs from that of {stored[0].folder} by "
            f"{differences[worst]:.3g} (root mean square), expected at most {noise:.3g}; measure both with the camera "
            "in one place, the same lamps on, and the other projectors on and black, or add --cameras if several "
            "cameras saw the same projectors"
        )
    return differences[worst] / bright if bright > 0 else 0.0


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(values**2)))

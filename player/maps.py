"""The folder correction/ of a calibration: every row map that the player uses, and the manifest, written last.

correction : T⁺ of the near light, camera picture -> projector picture (the thesis' correction map).
transport : near light, projector picture -> camera picture (what the camera will see).
far : the far light's factors D, M, U, if the room has any: projector picture -> cells -> cells -> camera picture.
undo : D' and M', which predict the far light of a *compensated* picture from the desired one, so that it can be
subtracted before T⁺: p = T⁺ (b − U M' D' b), the fixed point of p = T⁺ (b − U M D p); see tools/inverse/far_light.py.
refinement : what the player's projected gradient steps need beside T: Tᵀ, step sizes, and direct mapping to start from.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from player import exr, row_map
from player.calibration import StoredCalibration
from player.errors import InputError
from player.files import check_file, describe_files, read_toml, write_toml
from player.generation import read_steadily
from player.row_map import RowMap
from player.writing.replacing import replacing_folder

FORMAT = 1
FOLDER, MANIFEST, STEP_SIZE = "correction", "manifest.toml", "step_size.exr"


@dataclass(frozen=True)
class FarMaps:
    """gather: picture -> cells; mix: cells -> cells; scatter: cells -> picture. Cells are a picture of height 1."""

    gather: RowMap
    mix: RowMap
    scatter: RowMap

    @property
    def count(self) -> int:
        """Entries."""
        return self.gather.count + self.mix.count + self.scatter.count


@dataclass(frozen=True)
class RefinementMaps:
    """What refinement needs beside the transport (player/refinement.py); camera pixels outside the mask are left out.

    dual : Tᵀ of the near light, camera picture -> projector picture.
    far_dual : the far light's Uᵀ, Mᵀ, Dᵀ, if the room has any: camera picture -> cells -> cells -> projector picture.
    direct : direct mapping, one entry a row: the camera pixel that a projector pixel lights most, over its floodlight.
    step_size : (projector height, projector width, 3) float32, 1 / (TᵀT·1), 0 where no camera pixel is lit.
    """

    dual: RowMap
    far_dual: FarMaps | None
    direct: RowMap
    step_size: NDArray[np.float32]


@dataclass(frozen=True)
class RoomMaps:
    """Everything that the frame loop multiplies with.

    white : the radiance level that most of the room can reach (`--white auto`).
    details : what the builder wrote beside: options, clusters, bounds.
    refinement : None if it was left out, when the maps were built or read.
    """

    correction: RowMap
    transport: RowMap
    far: FarMaps | None
    undo: FarMaps | None
    white: float
    details: dict[str, Any] = field(default_factory=dict)
    refinement: RefinementMaps | None = None

    @property
    def correction_in_steps(self) -> float:
        """What T⁺ b takes over what a step of refinement takes, T p and Tᵀ r, in entries; 0 without refinement."""
        if self.refinement is None:
            return 0.0
        chains = self.far, self.refinement.far_dual
        step = self.transport.count + self.refinement.dual.count + sum(chain.count for chain in chains if chain)
        return (self.correction.count + (self.undo.count if self.undo else 0)) / max(step, 1)

    def named(self) -> dict[str, RowMap]:
        """Every distinct map with the folder it is stored in, relative to correction/."""
        maps = {".": self.correction, "transport": self.transport}
        if self.far is not None and self.undo is not None:
            maps |= {"far_gather": self.far.gather, "far_mix": self.far.mix, "far_scatter": self.far.scatter}
            maps |= {"undo_gather": self.undo.gather, "undo_mix": self.undo.mix}  # U is shared: far_scatter
        if self.refinement is not None:
            maps |= {"dual": self.refinement.dual, "direct": self.refinement.direct}
            far = self.refinement.far_dual
            if far is not None:
                maps |= {"dual_gather": far.gather, "dual_mix": far.mix, "dual_scatter": far.scatter}
        return maps


@contextmanager
def replacing(stored: StoredCalibration) -> Iterator[Path]:
    """Hold the calibration's correction/ before the long work; yields a stage for `write_maps`, which replaces it.

    Raises InputError if another process is building it, or has replaced the calibration meanwhile.
    """
    with replacing_folder(stored.folder / FOLDER, lambda _: stored.refuse_replaced()) as stage:
        yield stage


def write_maps(maps: RoomMaps, stored: StoredCalibration, stage: Path) -> None:
    """Write every map, and the manifest last."""
    sizes = {name: row_map.write(packed, stage / name) for name, packed in maps.named().items()}
    if maps.refinement is not None:
        exr.write_rgb(stage / STEP_SIZE, maps.refinement.step_size)
    manifest = {
        "format": FORMAT,
        "calibration": stored.fingerprint,
        "white": maps.white,
        **maps.details,
        "maps": sizes,
        "files": describe_files(stage),
    }
    write_toml(stage / MANIFEST, manifest)


def read_maps(stored: StoredCalibration, *, refinement: bool = True) -> RoomMaps:
    """Read and check correction/; InputError with the command that rebuilds it if anything is missing or damaged.

    refinement : read what refinement needs, too, if it is there.
    All of it is of one generation, even if another process builds the maps meanwhile.
    """
    return read_steadily(stored.folder / FOLDER / MANIFEST, lambda: _read_maps(stored, refinement))


def _read_maps(stored: StoredCalibration, refinement: bool) -> RoomMaps:
    folder = stored.folder / FOLDER
    fix = f"rebuild it with: build-correction-map {stored.folder}"
    manifest = read_toml(folder / MANIFEST, fix)
    _check_manifest(manifest, stored, folder / MANIFEST, fix)
    sizes = manifest["maps"]
    wanted = [name for name in sizes if refinement or not (name == "direct" or name.startswith("dual"))]
    maps = {name: _read_map(folder, name, sizes[name], manifest["files"], fix) for name in wanted}
    if not {".", "transport"} <= maps.keys():
        raise InputError(f"{folder / MANIFEST}: does not list the correction and transport maps; {fix}")
    far = undo = None
    if "far_mix" in maps:
        far, undo = _far_maps(maps, folder, fix)
    details = {key: value for key, value in manifest.items() if key not in ("maps", "files")}
    further = _refinement_maps(maps, stored, manifest["files"], fix) if "dual" in maps else None
    result = RoomMaps(maps["."], maps["transport"], far, undo, float(manifest["white"]), details, further)
    _check_shapes(result, stored, folder, fix)
    return result


def _check_manifest(manifest: dict[str, Any], stored: StoredCalibration, path: Path, fix: str) -> None:
    if manifest.get("format") != FORMAT:
        raise InputError(f"{path}: format {manifest.get('format')!r}, this version reads {FORMAT}; {fix}")
    if manifest.get("calibration") != stored.fingerprint:
        raise InputError(f"{path}: made for another state of {stored.folder}/calibration.toml; {fix}")
    tables = all(isinstance(manifest.get(key), dict) for key in ("maps", "files"))
    white = manifest.get("white")
    if not (tables and isinstance(white, float) and 0 < white < float("inf")):
        raise InputError(f"{path}: lacks its maps, its files or a positive white level; {fix}")


def _read_map(folder: Path, name: str, sizes: Any, files: dict[str, Any], fix: str) -> RowMap:
    if not isinstance(sizes, dict):
        raise InputError(f"{folder / MANIFEST}: the map {name!r} has no sizes; {fix}")
    for file in ("lookup.exr", "entries.exr", *(["index.exr"] if sizes.get("wide_index") else [])):
        check_file(folder, (Path(name) / file).as_posix(), files, fix)
    return row_map.read(folder / name, sizes, fix)


def _far_maps(maps: dict[str, RowMap], folder: Path, fix: str) -> tuple[FarMaps, FarMaps]:
    try:
        far = FarMaps(maps["far_gather"], maps["far_mix"], maps["far_scatter"])
        return far, FarMaps(maps["undo_gather"], maps["undo_mix"], far.scatter)
    except KeyError as error:
        raise InputError(f"{folder / MANIFEST}: does not list the map {error}; {fix}") from None


def _refinement_maps(
    maps: dict[str, RowMap], stored: StoredCalibration, files: dict[str, Any], fix: str
) -> RefinementMaps:
    folder, projector = stored.folder / FOLDER, stored.calibration.projector
    path = check_file(folder, STEP_SIZE, files, fix)
    header = exr.read_header(path)
    if (header.height, header.width) != projector.shape:
        found = f"{header.width}x{header.height}"
        raise InputError(f"{path}: {found}, the projector is {projector.width}x{projector.height}; {fix}")
    step_size = exr.read_rgb(path)
    if not (np.isfinite(step_size).all() and step_size.min() >= 0):
        raise InputError(f"{path}: holds NaN, infinity or a negative step; {fix}")
    try:
        far = None
        if "far_mix" in maps:
            far = FarMaps(maps["dual_gather"], maps["dual_mix"], maps["dual_scatter"])
        return RefinementMaps(maps["dual"], far, maps["direct"], step_size)
    except KeyError as error:
        raise InputError(f"{folder / MANIFEST}: does not list the map {error}; {fix}") from None


def _check_shapes(maps: RoomMaps, stored: StoredCalibration, folder: Path, fix: str) -> None:
    camera, projector = stored.calibration.camera.shape, stored.calibration.projector.shape
    chains = [(maps.correction, camera, projector), (maps.transport, projector, camera)]
    if maps.far is not None and maps.undo is not None:
        cells = maps.far.mix.output_shape
        chains += [(maps.far.gather, projector, cells), (maps.far.mix, cells, cells)]
        chains += [(maps.far.scatter, cells, camera)]
        chains += [(maps.undo.gather, camera, cells), (maps.undo.mix, cells, cells)]
        if maps.refinement is not None and maps.refinement.far_dual is not None:
            back = maps.refinement.far_dual
            chains += [(back.gather, camera, cells), (back.mix, cells, cells), (back.scatter, cells, projector)]
    if maps.refinement is not None:
        chains += [(maps.refinement.dual, camera, projector), (maps.refinement.direct, camera, projector)]
    for packed, source, output in chains:
        if (packed.source_shape, packed.output_shape) != (source, output):
            raise InputError(
                f"{folder}: a map goes from {packed.source_shape} to {packed.output_shape} (height, width), "
                f"the calibration needs {source} to {output}; {fix}"
            )

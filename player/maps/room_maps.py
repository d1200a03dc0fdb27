"""The folder correction/ of a calibration: every row map that the player uses, and the manifest, written last.

correction : T⁺ of the near light, camera picture -> projector picture (the thesis' correction map).
transport : near light, projector picture -> camera picture (what the camera will see).
far : the far light's factors D, M, U, if the room has any: projector picture -> parts -> cells -> camera picture.
blurred : the blurred light's factors P, B, if the room has any: projector picture -> cells -> camera picture.
undo : D' and M', which predict the far light of a *compensated* picture from the desired one, so that it can be
subtracted before T⁺: p = T⁺ (b − U M' D' b), the fixed point of p = T⁺ (b − U M D p); see tools/inverse/far_light.py.
None without far light, and where T⁺ is of near and far light in one (build --inverse thesis).
refinement : what the player's projected gradient steps need beside T: TᵀW, step sizes, a prior, and direct mapping to
start from.
mixing : how the camera's colours mix the primaries; all of these maps are of the transport T̃ beyond it (mixing.py).
words : T and Tᵀ in words of 4 bytes, for a GPU, where these are certified, beside their entries of 16 (word_map.py).
"""

from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import brief
from counterlight.calibration import RADIANCE, StoredCalibration
from counterlight.errors import InputError
from counterlight.files import exr
from counterlight.files.generation import read_steadily
from counterlight.files.manifest import describe_files, write_toml
from counterlight.files.reading import DescribedFiles, read_toml
from counterlight.files.tables import Table
from counterlight.maps import mixing as mixings
from counterlight.maps import prior, row_map, word_map
from counterlight.maps.mixing import Mixing
from counterlight.maps.prior import Prior
from counterlight.maps.row_map import RowMap
from counterlight.maps.word_map import RoomWords, WordMap
from counterlight.writing.replacing import replacing_folder

T = TypeVar("T")
R = TypeVar("R")
Shapes: TypeAlias = tuple[tuple[int, int], tuple[int, int]]  # of output and source

FORMAT = 2  # 1 knew no weights and no prior
UNUSABLE = "give more --regularize, or look for what is extreme in the calibration"
FOLDER, MANIFEST, STEP_SIZE = "correction", "manifest.toml", "step_size.exr"
AT_A_TIME = 2  # maps that are read or written
WEIGHTS, SEEN, LIT = "weights.exr", "seen.exr", "lit.exr"
WORDS = "words"
IN_ENTRIES = {".", "direct", "undo_gather", "undo_mix"}  # maps that are never in words


@dataclass(frozen=True)
class FarMaps:
    """gather: picture -> parts of cells; mix: parts -> cells; scatter: cells -> picture. Both are pictures of height 1.

    A cell has one part, or several where more pixels than a texture's width are gathered into it.
    """

    gather: RowMap
    mix: RowMap
    scatter: RowMap

    __repr__ = brief

    @property
    def parts(self) -> tuple[RowMap, ...]:
        """In the order in which they are applied."""
        return self.gather, self.mix, self.scatter


@dataclass(frozen=True)
class BlurredMaps:
    """gather: picture -> parts of cells, as of FarMaps; scatter: parts -> picture. They fill a picture line by line."""

    gather: RowMap
    scatter: RowMap

    __repr__ = brief

    @property
    def parts(self) -> tuple[RowMap, ...]:
        """In the order in which they are applied."""
        return self.gather, self.scatter


@dataclass(frozen=True)
class RefinementMaps:
    """What refinement needs beside the transport (pipeline/refinement.py); camera pixels outside the mask are left out.

    dual : TᵀW of the near light, camera picture -> projector picture.
    far_dual : the far light's UᵀW, Mᵀ, Dᵀ, if the room has any: camera picture -> parts -> cells -> projector picture.
    blurred_dual : the blurred light's BᵀW, Pᵀ, if the room has any.
    direct : direct mapping, one entry a row: the camera pixel that a projector pixel lights most, over its T·1.
    step_size : (projector height, projector width, 3) float32, 1 / (TᵀW T·1 + the prior's bound), 0 where no camera
    pixel is lit.
    prior : what the drive is drawn to where the camera says little.
    weights : W's diagonal, (camera height, camera width) float32.
    seen : (projector height, projector width) float32, how well the camera sees a pixel, 1 for as well as most.
    lit : (camera height, camera width) float32, 1 for camera pixels that figures refer to, else 0.
    """

    dual: RowMap
    far_dual: FarMaps | None
    direct: RowMap
    step_size: NDArray[np.float32]
    prior: Prior
    weights: NDArray[np.float32]
    seen: NDArray[np.float32]
    lit: NDArray[np.float32]
    blurred_dual: BlurredMaps | None = None

    __repr__ = brief

    @property
    def beside(self) -> list[FarMaps | BlurredMaps]:
        """What there is of TᵀW beside `dual`."""
        return [chain for chain in (self.blurred_dual, self.far_dual) if chain is not None]


@dataclass(frozen=True)
class RoomMaps:
    """Everything that the frame loop multiplies with.

    white : the radiance level that most of the room can reach (`--white auto`).
    details : what the builder wrote beside: options, clusters, bounds.
    refinement : None if it was left out, when the maps were built or read.
    mixing : of the primaries, beyond which the maps stand.
    bounded : whether no camera pixel is asked for what it cannot have by itself, b within 0 to T·1; not in chapter 5.
    words : None if there are none, or they were not asked for.
    """

    correction: RowMap
    transport: RowMap
    far: FarMaps | None
    undo: FarMaps | None
    white: float
    details: dict[str, Any] = field(default_factory=dict)
    refinement: RefinementMaps | None = None
    mixing: Mixing = field(default_factory=Mixing)
    bounded: bool = True
    words: RoomWords | None = None
    blurred: BlurredMaps | None = None

    def __repr__(self) -> str:
        mib = sum(packed.nbytes for packed in self.named().values()) / 2**20
        refined = "" if self.refinement is None else ", with refinement"
        camera, projector = self.transport.output_shape, self.transport.source_shape
        return f"<RoomMaps: camera {camera}, projector {projector}, white {self.white:.4g}, {mib:.1f} MiB{refined}>"

    @property
    def beside(self) -> list[FarMaps | BlurredMaps]:
        """What there is of T beside `transport`."""
        return [chain for chain in (self.blurred, self.far) if chain is not None]

    @property
    def correction_in_steps(self) -> float:
        """What T⁺ b takes over what a step of refinement takes, T p and Tᵀ r, in entries; 0 without refinement."""
        undo = sum(part.count for part in self.undo.parts) if self.undo else 0
        return (self.correction.count + undo) / self._entries_of_a_step

    @property
    def direct_in_steps(self) -> float:
        """The same of direct mapping."""
        return 0.0 if self.refinement is None else self.refinement.direct.count / self._entries_of_a_step

    @property
    def _entries_of_a_step(self) -> float:
        """Infinite without refinement."""
        if self.refinement is None:
            return float("inf")
        parts = [part for chain in (*self.beside, *self.refinement.beside) for part in chain.parts]
        step = self.transport.count + self.refinement.dual.count + sum(part.count for part in parts)
        return float(max(step, 1))

    def named(self) -> dict[str, RowMap]:
        """Every distinct map with the folder it is stored in, relative to correction/."""
        maps = {".": self.correction, "transport": self.transport}
        if self.far is not None:
            maps |= {"far_gather": self.far.gather, "far_mix": self.far.mix, "far_scatter": self.far.scatter}
        if self.undo is not None:
            maps |= {"undo_gather": self.undo.gather, "undo_mix": self.undo.mix}  # U is shared: far_scatter
        if self.refinement is not None:
            maps |= {"dual": self.refinement.dual, "direct": self.refinement.direct}
            far = self.refinement.far_dual
            if far is not None:
                maps |= {"dual_gather": far.gather, "dual_mix": far.mix, "dual_scatter": far.scatter}
        if self.blurred is not None:
            maps |= {"blurred_gather": self.blurred.gather, "blurred_scatter": self.blurred.scatter}
        if self.refinement is not None and self.refinement.blurred_dual is not None:
            dual = self.refinement.blurred_dual
            maps |= {"blurred_dual_gather": dual.gather, "blurred_dual_scatter": dual.scatter}
        return maps

    def in_words(self, white: float) -> dict[int, WordMap]:
        """Words for T and Tᵀ, by the identity of the map that each stands for; none where they miss their bound.

        What they change is judged beside the white that is shown, which may be darker than the maps'.
        """
        if self.words is None or self.words.used * self.white > white:
            return {}
        named = self.named()
        return {id(named[name]): made for name, made in self.words.maps.items()}


@contextmanager
def replacing(stored: StoredCalibration) -> Iterator[Path]:
    """Hold the calibration's correction/ before the long work; yields a stage for `write_maps`, which replaces it.

    Raises InputError if another process is building it, or has replaced the calibration meanwhile.
    """
    with replacing_folder(stored.folder / FOLDER, lambda _: stored.refuse_replaced()) as stage:
        yield stage


def write_maps(maps: RoomMaps, stored: StoredCalibration, stage: Path) -> None:
    """Write every map, and the manifest last; InputError for maps that `read_maps` would refuse."""
    check_white(maps.white)
    if maps.refinement is not None:
        folder = stored.folder / FOLDER
        _check_positive(maps.refinement.step_size, f"{folder / STEP_SIZE}", UNUSABLE)
        maps.refinement.prior.check(lambda name: f"{folder / prior.file_of(name)}", UNUSABLE)
    sizes = _each(maps.named(), lambda name, packed: row_map.write(packed, stage / name))
    if maps.refinement is not None:
        exr.write_plain(stage / STEP_SIZE, exr.rgb(maps.refinement.step_size))
        maps.refinement.prior.write(stage)
        greys = {WEIGHTS: maps.refinement.weights, SEEN: maps.refinement.seen, LIT: maps.refinement.lit}
        for name, values in greys.items():
            exr.write_plain(stage / name, {"Y": values})
    mixings.write(maps.mixing, stage)
    manifest = {
        "format": FORMAT,
        "calibration": stored.fingerprint,
        "white": maps.white,
        "bounded": maps.bounded,
        **maps.details,
        **maps.mixing.to_toml(),
        "maps": sizes,
        **_write_words(maps.words, stage / WORDS),
        "files": describe_files(stage),
    }
    write_toml(stage / MANIFEST, manifest)


def _write_words(words: RoomWords | None, folder: Path) -> dict[str, Any]:
    if words is None:
        return {}
    sizes = _each(words.maps, lambda name, made: word_map.write(made, folder / name))
    return {WORDS: {"used": words.used, "maps": sizes}}


def check_white(white: float) -> None:
    """InputError for a white level that no map is made for; asked before the work."""
    if not RADIANCE[0] <= white <= RADIANCE[1]:
        raise InputError(
            f"white is a camera radiance of {white:g}, expected {RADIANCE[0]:g} to {RADIANCE[1]:g}; give T and the "
            "ambient light in another unit"
        )


def read_maps(stored: StoredCalibration, *, refinement: bool = True, words: bool = False) -> RoomMaps:
    """Read and check correction/; InputError with the command that rebuilds it if anything is missing or damaged.

    refinement, words : read what refinement needs, and the maps in words, too, if they are there.
    All of it is of one generation, even if another process builds the maps meanwhile.
    """
    return read_steadily(stored.folder / FOLDER / MANIFEST, lambda: _read_maps(stored, refinement, words))


def _read_maps(stored: StoredCalibration, refinement: bool, words: bool) -> RoomMaps:
    folder = stored.folder / FOLDER
    fix = f"rebuild it with: counterlight build {stored.folder}"
    values = read_toml(folder / MANIFEST, fix)
    manifest = Table(values, f"{folder / MANIFEST}", fix)
    manifest.format(FORMAT)
    if values.get("calibration") != stored.fingerprint:
        raise manifest.refusal(f": made for another state of {stored.folder}/calibration.toml")
    white = manifest.number("white", None, *RADIANCE)
    files = DescribedFiles(folder, manifest.table("files").values, fix)
    sizes = _sizes(manifest, stored, refinement=refinement)
    maps = _each(sizes, lambda name, size: row_map.read(folder / name, size, files.opened))
    far = undo = further = None
    if "far_mix" in maps:
        far = FarMaps(maps["far_gather"], maps["far_mix"], maps["far_scatter"])
        undo = FarMaps(maps["undo_gather"], maps["undo_mix"], far.scatter) if "undo_mix" in maps else None
    blurred = _blurred(maps, "blurred")
    if "dual" in maps:
        dual = FarMaps(maps["dual_gather"], maps["dual_mix"], maps["dual_scatter"]) if far else None
        projector, camera = stored.calibration.projector.shape, stored.calibration.camera.shape
        weights = _read_positive(files, WEIGHTS, camera, "the camera")[..., 0]
        lit = _read_positive(files, LIT, camera, "the camera")[..., 0] if LIT in files else weights > 0
        pictures = (
            _read_positive(files, STEP_SIZE, projector, "the projector"),
            prior.read(files, projector),
            weights,
            _read_positive(files, SEEN, projector, "the projector")[..., 0],
            np.where((lit > 0) & (weights > 0), np.float32(1), np.float32(0)),
        )
        further = RefinementMaps(maps["dual"], dual, maps["direct"], *pictures, _blurred(maps, "blurred_dual"))
    mixing = mixings.read(manifest, files, stored.calibration.camera.shape)
    details = {key: value for key, value in values.items() if key not in ("colour", "maps", WORDS, "files")}
    bounded = manifest.truth("bounded", True)
    found = RoomMaps(maps["."], maps["transport"], far, undo, white, details, further, mixing, bounded, blurred=blurred)
    if not words or further is None or WORDS not in manifest:
        return found
    return replace(found, words=_read_words(manifest, found, files))


def _blurred(maps: Mapping[str, RowMap], name: str) -> BlurredMaps | None:
    if f"{name}_gather" not in maps:
        return None
    return BlurredMaps(maps[f"{name}_gather"], maps[f"{name}_scatter"])


def _read_words(manifest: Table, maps: RoomMaps, files: DescribedFiles) -> RoomWords:
    table, shapes = manifest.table(WORDS), _shapes_of_words(maps.named())
    listed = table.table("maps")

    def read(name: str, ends: Shapes) -> WordMap:
        return word_map.read(files.folder / WORDS / name, listed.table(name), ends, files.opened)

    wanted = {name: shapes[name] for name in sorted(shapes.keys() - IN_ENTRIES)}
    return RoomWords(_each(wanted, read), table.number("used", None, 0, 1))


def _each(given: Mapping[str, T], job: Callable[[str, T], R]) -> dict[str, R]:
    """What a job makes of each, some at a time: hashing, copying and files leave Python's lock to others."""
    with ThreadPoolExecutor(AT_A_TIME) as threads:
        return dict(zip(given, threads.map(job, given.keys(), given.values()), strict=True))


def _shapes_of_words(maps: Mapping[str, RowMap]) -> dict[str, Shapes]:
    """Of output and source: those of the maps, but the far light's dual is its transpose, part for part."""
    shapes = {name: (each.output_shape, each.source_shape) for name, each in maps.items()}
    for name, of in (("dual_gather", "far_scatter"), ("dual_mix", "far_mix"), ("dual_scatter", "far_gather")):
        if name in shapes:
            output, source = shapes[of]
            shapes[name] = source, output
    return shapes


def _sizes(manifest: Table, stored: StoredCalibration, *, refinement: bool) -> dict[str, Table]:
    """What the manifest says of each map that is to be read; InputError unless they are all there and fit together.

    The names are ours: what else a manifest lists names no file.
    """
    listed = manifest.table("maps")
    camera, projector = stored.calibration.camera.shape, stored.calibration.projector.shape
    ends = {".": (camera, projector), "transport": (projector, camera)}
    dual = refinement and "dual" in listed
    if "far_mix" in listed:
        cells, parts, _ = row_map.shapes(listed.table("far_mix"))
        ends |= {"far_gather": (projector, parts), "far_mix": (parts, cells), "far_scatter": (cells, camera)}
        if "undo_gather" in listed or "undo_mix" in listed:
            _, parts, _ = row_map.shapes(listed.table("undo_mix"))
            ends |= {"undo_gather": (camera, parts), "undo_mix": (parts, cells)}
        if dual:
            _, parts, _ = row_map.shapes(listed.table("dual_mix"))
            ends |= {"dual_gather": (camera, parts), "dual_mix": (parts, cells), "dual_scatter": (cells, projector)}
    if "blurred_gather" in listed:
        cells = row_map.shapes(listed.table("blurred_gather"))[0]
        ends |= {"blurred_gather": (projector, cells), "blurred_scatter": (cells, camera)}
        if dual:
            cells = row_map.shapes(listed.table("blurred_dual_gather"))[0]
            ends |= {"blurred_dual_gather": (camera, cells), "blurred_dual_scatter": (cells, projector)}
    if dual:
        ends |= {"dual": (camera, projector), "direct": (camera, projector)}
    sizes = {name: listed.table(name) for name in ends}
    for name, table in sizes.items():
        output, source, _ = row_map.shapes(table)
        if (source, output) != ends[name]:
            raise table.refusal(
                f": a map from {source} to {output} (height, width), the calibration needs {ends[name][0]} to "
                f"{ends[name][1]}"
            )
    return sizes


def _read_positive(files: DescribedFiles, name: str, shape: tuple[int, int], whose: str) -> NDArray[np.float32]:
    """A picture of steps, weights or shares; InputError if it does not fit, or is damaged."""
    picture = exr.read_described(files, name, shape, whose)
    _check_positive(picture, f"{files.folder / name}", files.fix)
    return picture


def _check_positive(picture: NDArray[np.float32], where: str, fix: str) -> None:
    if not (np.isfinite(picture).all() and picture.min() >= 0):
        raise InputError(f"{where}: holds NaN, infinity or something negative; {fix}")

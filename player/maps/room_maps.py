"""The folder correction/ of a calibration: every row map that the player uses, and the manifest, written last.

correction : T⁺ of the near light, camera picture -> projector picture (the thesis' correction map).
transport : near light, projector picture -> camera picture (the predicted camera picture).
far : factors D, M, U of the far light, if any: projector picture -> parts -> cells -> camera picture.
blurred : factors P, B of the blurred light, if any: projector picture -> cells -> camera picture.
undo : D' and M', which predict the far light of the *compensated* picture from the target. This light is subtracted
    before T⁺: p = T⁺ (b − U M' D' b), the fixed point of p = T⁺ (b − U M D p); see tools/inverse/far_light.py. None
    without far light, or if T⁺ itself includes the inverse of far light (build --inverse thesis).
refinement : inputs of the player's projected gradient steps besides T: TᵀW, step sizes, a prior, and direct mapping as
    a start.
mixing : mixing of the primaries by the camera; all maps belong to the transport T̃ without it (mixing.py).
words : T and Tᵀ in certified words of 4 bytes, for a GPU, in addition to their 16-byte entries (word_map.py).
"""

from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from counterlight import plots
from counterlight.arrays import BoolArray, brief
from counterlight.calibration import RADIANCE, StoredCalibration
from counterlight.errors import InputError
from counterlight.files import exr
from counterlight.files.manifest import describe_files, read_steadily, write_toml
from counterlight.files.reading import DescribedFiles, read_toml
from counterlight.files.tables import Table
from counterlight.maps import mixing as mixings
from counterlight.maps import prior, row_map, word_map
from counterlight.maps.chain import Chain
from counterlight.maps.mixing import Mixing
from counterlight.maps.prior import Prior
from counterlight.maps.row_map import RowMap
from counterlight.maps.word_map import RoomWords, WordMap
from counterlight.writing.replacing import replacing_folder

if TYPE_CHECKING:
    from matplotlib.figure import Figure

T = TypeVar("T")
R = TypeVar("R")
MapChain: TypeAlias = Chain[RowMap, RowMap | None]
Shapes: TypeAlias = tuple[tuple[int, int], tuple[int, int]]  # (height, width) of output and source

FORMAT = 2  # format 1 had no weights and no prior
UNUSABLE = "give more --regularize, or look for what is extreme in the calibration"
FOLDER, MANIFEST, STEP_SIZE = "correction", "manifest.toml", "step_size.exr"
AT_A_TIME = 2  # number of maps that are read or written in parallel
WEIGHTS, SEEN, LIT = "weights.exr", "seen.exr", "lit.exr"
WORDS = "words"
CHAINS = {  # folders of each chain's gather, mix and scatter; far light and the light that T⁺ removes share U
    "far": ("far_gather", "far_mix", "far_scatter"),
    "undo": ("undo_gather", "undo_mix", "far_scatter"),
    "dual": ("dual_gather", "dual_mix", "dual_scatter"),
    "blurred": ("blurred_gather", None, "blurred_scatter"),
    "blurred_dual": ("blurred_dual_gather", None, "blurred_dual_scatter"),
}
IN_ENTRIES = {".", "direct", "undo_gather", "undo_mix"}  # maps that are never stored in words


@dataclass(frozen=True)
class RefinementMaps:
    """Inputs of refinement besides the transport (pipeline/refinement.py). Camera pixels without weight are left out.

    dual : TᵀW of the near light, camera picture -> projector picture.
    far_dual : the far light's UᵀW, Mᵀ, Dᵀ, if any: camera picture -> parts -> cells -> projector picture.
    direct : direct mapping, one entry per row: the camera pixel that a projector pixel lights most, divided by its T·1.
    step_size : (projector height, projector width, 3) float32. 1 / (TᵀW T·1 + the prior's bound), or 0 if no camera
        pixel is lit.
    prior : prior on the drive of pixels that the camera hardly sees.
    weights : (camera height, camera width) float32. Diagonal of W.
    seen : (projector height, projector width) float32. How well the camera sees a pixel; 1 for most pixels.
    blurred_dual : the blurred light's BᵀW, Pᵀ, if any.
    """

    dual: RowMap
    far_dual: MapChain | None
    direct: RowMap
    step_size: NDArray[np.float32]
    prior: Prior
    weights: NDArray[np.float32]
    seen: NDArray[np.float32]
    blurred_dual: MapChain | None = None

    __repr__ = brief

    @property
    def chains(self) -> list[MapChain]:
        """The chains of TᵀW in addition to `dual`."""
        return [chain for chain in (self.blurred_dual, self.far_dual) if chain is not None]


@dataclass(frozen=True)
class RoomMaps:
    """Everything that the frame loop multiplies with.

    white : radiance that most of the room can reach (`--white auto`).
    details : further entries of the manifest: options, clusters, bounds.
    refinement : None if it was left out, when the maps were built or read.
    mixing : mixing of the primaries; the maps exclude it.
    bounded : whether b is limited to 0..T·1, so that no camera pixel gets an impossible target; False for the thesis'
        method (chapter 5).
    words : None if there are none, or if they were not requested.
    lit : (camera height, camera width). The lit camera pixels, to which figures refer; None if unknown.
    """

    correction: RowMap
    transport: RowMap
    far: MapChain | None
    undo: MapChain | None
    white: float
    details: dict[str, Any] = field(default_factory=dict)
    refinement: RefinementMaps | None = None
    mixing: Mixing = field(default_factory=Mixing)
    bounded: bool = True
    words: RoomWords | None = None
    blurred: MapChain | None = None
    lit: BoolArray | None = None

    def __repr__(self) -> str:
        mib = sum(packed.nbytes for packed in self.named().values()) / 2**20
        refined = "" if self.refinement is None else ", with refinement"
        camera, projector = self.transport.output_shape, self.transport.source_shape
        return f"<RoomMaps: camera {camera}, projector {projector}, white {self.white:.4g}, {mib:.1f} MiB{refined}>"

    @property
    def chains(self) -> list[MapChain]:
        """The chains of T in addition to `transport`."""
        return [chain for chain in (self.blurred, self.far) if chain is not None]

    @property
    def correction_in_steps(self) -> float:
        """Entries of T⁺ relative to the entries of one step of refinement (T and Tᵀ); 0 without refinement."""
        undo = sum(part.count for part in self.undo.factors) if self.undo else 0
        return (self.correction.count + undo) / self._entries_of_a_step

    @property
    def direct_in_steps(self) -> float:
        """Entries of direct mapping relative to the entries of one step of refinement; 0 without refinement."""
        return 0.0 if self.refinement is None else self.refinement.direct.count / self._entries_of_a_step

    @property
    def _entries_of_a_step(self) -> float:
        """Entries of T and Tᵀ; infinite without refinement."""
        if self.refinement is None:
            return float("inf")
        parts = [part for chain in (*self.chains, *self.refinement.chains) for part in chain.factors]
        step = self.transport.count + self.refinement.dual.count + sum(part.count for part in parts)
        return float(max(step, 1))

    def named(self) -> dict[str, RowMap]:
        """Return every distinct map by its folder, relative to correction/."""
        maps, further = {".": self.correction, "transport": self.transport}, self.refinement
        maps |= _named("far", self.far)
        maps = maps | _named("undo", self.undo) | maps  # `far` and `undo` share U; the far light's U is kept
        if further is not None:
            maps |= {"dual": further.dual, "direct": further.direct, **_named("dual", further.far_dual)}
        maps |= _named("blurred", self.blurred)
        return maps if further is None else maps | _named("blurred_dual", further.blurred_dual)

    def plot(self) -> "Figure":
        """Draw each pixel's number of entries, and the weights of refinement (needs matplotlib)."""
        pictures: dict[str, NDArray[Any]] = {
            "entries of T⁺ per projector pixel": self.correction.lookup[..., 2],
            "entries of T per camera pixel": self.transport.lookup[..., 2],
        }
        if self.refinement is not None:
            pictures["weights of camera pixels"] = self.refinement.weights
            pictures["how well the camera sees projector pixels"] = self.refinement.seen
        return plots.panels(repr(self).strip("<>"), pictures)

    def in_words(self, white: float) -> dict[int, WordMap]:
        """Return the maps of T and Tᵀ in words, by the id of the row map that each replaces; empty if the bound fails.

        The bound is relative to the shown white, which may be darker than the maps' white.
        """
        if self.words is None or self.words.used * self.white > white:
            return {}
        named = self.named()
        return {id(named[name]): made for name, made in self.words.maps.items()}


@contextmanager
def replacing(stored: StoredCalibration) -> Iterator[Path]:
    """Lock the calibration's correction/ before the long work; yields a staging folder for `write_maps`.

    Raises InputError if another process is building the maps, or has replaced the calibration meanwhile.
    """
    with replacing_folder(stored.folder / FOLDER, lambda _: stored.refuse_replaced()) as stage:
        yield stage


def write_maps(maps: RoomMaps, stored: StoredCalibration, stage: Path) -> None:
    """Write every map, and the manifest last; raises InputError for maps that `read_maps` would refuse."""
    check_white(maps.white)
    if maps.refinement is not None:
        folder = stored.folder / FOLDER
        _check_positive(maps.refinement.step_size, f"{folder / STEP_SIZE}", UNUSABLE)
        maps.refinement.prior.check(lambda name: f"{folder / prior.file_of(name)}", UNUSABLE)
    sizes = _each(maps.named(), lambda name, packed: row_map.write(packed, stage / name))
    if maps.refinement is not None:
        exr.write_plain(stage / STEP_SIZE, exr.rgb(maps.refinement.step_size))
        maps.refinement.prior.write(stage)
        for name, values in ((WEIGHTS, maps.refinement.weights), (SEEN, maps.refinement.seen)):
            exr.write_plain(stage / name, {"Y": values})
    if maps.lit is not None:
        exr.write_plain(stage / LIT, {"Y": maps.lit.astype(np.float32)})
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
    """Raise InputError for a white level outside the valid range; called before the long work."""
    if not RADIANCE[0] <= white <= RADIANCE[1]:
        raise InputError(
            f"white is a camera radiance of {white:g}, expected {RADIANCE[0]:g} to {RADIANCE[1]:g}; give T and the "
            "ambient light in another unit"
        )


def read_maps(stored: StoredCalibration, *, refinement: bool = True, words: bool = False) -> RoomMaps:
    """Read and check correction/; raises InputError with the rebuild command if anything is missing or damaged.

    refinement, words : whether to read the maps of refinement, and the maps in words, if they exist.

    All parts belong to one build, even if another process builds the maps meanwhile.
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
    camera, projector = stored.calibration.camera.shape, stored.calibration.projector.shape
    lit = _read_positive(files, LIT, camera, "the camera")[..., 0] > 0 if LIT in files else None
    further = None
    if "dual" in maps:
        pictures = (
            _read_positive(files, STEP_SIZE, projector, "the projector"),
            prior.read(files, projector),
            _read_positive(files, WEIGHTS, camera, "the camera")[..., 0],
            _read_positive(files, SEEN, projector, "the projector")[..., 0],
        )
        dual, blurred = (_chain(maps, name) for name in ("dual", "blurred_dual"))
        further = RefinementMaps(maps["dual"], dual, maps["direct"], *pictures, blurred)
    mixing = mixings.read(manifest, files, camera)
    details = {key: value for key, value in values.items() if key not in ("colour", "maps", WORDS, "files")}
    bounded = manifest.truth("bounded", True)
    far, undo, blurred = (_chain(maps, name) for name in ("far", "undo", "blurred"))
    light = maps["."], maps["transport"], far, undo
    found = RoomMaps(*light, white, details, further, mixing, bounded, blurred=blurred, lit=lit)
    if not words or further is None or WORDS not in manifest:
        return found
    return replace(found, words=_read_words(manifest, found, files))


def _named(name: str, chain: MapChain | None) -> dict[str, RowMap]:
    return {} if chain is None else dict(zip(filter(None, CHAINS[name]), chain.factors, strict=True))


def _chain(maps: Mapping[str, RowMap], name: str) -> MapChain | None:
    gather, mix, scatter = CHAINS[name]
    return Chain(maps[gather], None if mix is None else maps[mix], maps[scatter]) if gather in maps else None


def _read_words(manifest: Table, maps: RoomMaps, files: DescribedFiles) -> RoomWords:
    table, shapes = manifest.table(WORDS), _shapes_of_words(maps.named())
    listed = table.table("maps")

    def read(name: str, ends: Shapes) -> WordMap:
        return word_map.read(files.folder / WORDS / name, listed.table(name), ends, files.opened)

    wanted = {name: shapes[name] for name in sorted(shapes.keys() - IN_ENTRIES)}
    return RoomWords(_each(wanted, read), table.number("used", None, 0, 1))


def _each(given: Mapping[str, T], job: Callable[[str, T], R]) -> dict[str, R]:
    """Apply a job to each item, AT_A_TIME in parallel; hashing, copying and file access release Python's lock."""
    with ThreadPoolExecutor(AT_A_TIME) as threads:
        return dict(zip(given, threads.map(job, given.keys(), given.values()), strict=True))


def _shapes_of_words(maps: Mapping[str, RowMap]) -> dict[str, Shapes]:
    """Return output and source shapes of the maps; the far light's dual has the transposed shapes, factor by factor."""
    shapes = {name: (each.output_shape, each.source_shape) for name, each in maps.items()}
    for name, of in (("dual_gather", "far_scatter"), ("dual_mix", "far_mix"), ("dual_scatter", "far_gather")):
        if name in shapes:
            output, source = shapes[of]
            shapes[name] = source, output
    return shapes


def _sizes(manifest: Table, stored: StoredCalibration, *, refinement: bool) -> dict[str, Table]:
    """Return the manifest's table of each required map; raises InputError unless all exist and fit together.

    The names are fixed in the code, so that a manifest cannot name other files.
    """
    listed = manifest.table("maps")
    camera, projector = stored.calibration.camera.shape, stored.calibration.projector.shape
    ends = {".": (camera, projector), "transport": (projector, camera)}
    chains = {"far": (projector, camera), "undo": (camera, camera), "blurred": (projector, camera)}
    chains = {name: ends for name, ends in chains.items() if any(part in listed for part in CHAINS[name][:2] if part)}
    if refinement and "dual" in listed:
        ends |= {"dual": (camera, projector), "direct": (camera, projector)}
        pairs = {"far": "dual", "blurred": "blurred_dual"}
        chains |= {dual: (camera, projector) for name, dual in pairs.items() if name in chains}
    for name, (source, output) in chains.items():
        gather, mix, scatter = CHAINS[name]
        cells, _ = ends.setdefault(scatter, (row_map.shapes(listed.table(mix or gather))[0], output))
        parts = row_map.shapes(listed.table(mix))[1] if mix else cells
        ends |= {gather: (source, parts), **({mix: (parts, cells)} if mix else {})}
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
    """Read a picture of steps, weights or shares; raises InputError if it does not fit, or is damaged."""
    picture = exr.read_described(files, name, shape, whose)
    _check_positive(picture, f"{files.folder / name}", files.fix)
    return picture


def _check_positive(picture: NDArray[np.float32], where: str, fix: str) -> None:
    if not (np.isfinite(picture).all() and picture.min() >= 0):
        raise InputError(f"{where}: holds NaN, infinity or something negative; {fix}")

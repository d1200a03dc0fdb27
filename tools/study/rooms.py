"""The rooms of a study: scenes and calibration folders as rooms, and a picture in a room as a task."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TypeVar

import numpy as np

from counterlight import calibration as calibrations
from counterlight.arrays import FloatArray
from counterlight.errors import InputError
from counterlight.maps.room_maps import MapChain, RefinementMaps, RoomMaps
from counterlight.maps.row_map import RowMap, SparseRows, pack
from counterlight.pipeline.fitting import on_cameras
from counterlight.pipeline.room import Room
from counterlight.tools.clusters.components import find_clusters
from counterlight.tools.colour.tiers import Tier, tier_of
from counterlight.tools.inverse.build import BuiltRoom, build_maps
from counterlight.tools.inverse.direct import direct_mapping, triangulated_mapping
from counterlight.tools.inverse.near_light import InverseOptions
from counterlight.tools.inverse.refinement_maps import pack_chain, refinement_maps
from counterlight.tools.shipped import shipped_scenes
from counterlight.tools.simulation import room as simulation
from counterlight.tools.simulation.scene import Scene, load_scene
from counterlight.tools.simulation.simulate import simulate
from counterlight.tools.solve.box import Box
from counterlight.tools.solve.quality import Quality, measure
from counterlight.tools.study.frames import Bench
from counterlight.tools.study.pictures import Picture
from counterlight.tools.transport.objective import DEFAULT_AIMS, objective_of
from counterlight.tools.transport.storage import read_transport
from counterlight.tools.transport.transport import Transport, channel, channels

R = TypeVar("R")
ENTRY_BYTES = 170  # bytes per entry of T⁺: its maps, the player's copy, the inverse (146 measured)
BEYOND = 0.1 / 255  # drive; a smaller excess over 0..1 is rounding, not clipping
TINY = 1e-300


def processor_seconds(work: Callable[[], R]) -> tuple[R, float]:
    """Returns the result of `work` and its processor time over all cores, which other load hardly changes."""
    start = time.process_time()
    result = work()
    return result, time.process_time() - start


def find_places(given: Sequence[Path], names: Sequence[str]) -> list[Path]:
    """Returns scene files and calibration folders to study: those given, and shipped scenes by name.

    Without any, returns all shipped scenes with one camera.

    Raises InputError for anything else, before the work begins.
    """
    shipped = shipped_scenes()
    unknown = [name for name in names if name not in shipped]
    if unknown:
        raise InputError(f"--scenes {unknown[0]}: no such scene is shipped; there are {', '.join(shipped)}")
    for path in given:
        if path.is_dir() or not (path.exists() or path.suffix):
            calibrations.read(path)
        else:
            load_scene(path)
    usual = (path for path in shipped.values() if not load_scene(path).others)
    places = [*given, *(shipped[name] for name in names)] or list(usual)
    repeated = [path for path in places if [p.stem for p in places].count(path.stem) > 1]
    if repeated:
        raise InputError(f"{repeated[0]}: another room of this study is called {repeated[0].stem}, too; rename one")
    return places


def open_room(place: Path, size: tuple[int, int], colour: str = "auto") -> "StudyRoom":
    """Open a calibration, or simulate a scene with its camera fitted into `size` (height, width).

    The projector is scaled as the camera is. Files stay unchanged.

    colour : one of choices.COLOURS.
    """
    if place.is_dir():
        stored = calibrations.read(place)
        transport = read_transport(stored)
        if transport.blurred is not None:
            raise InputError(
                f"{place}: its blurred light is kept in blocks of pixels, of which no T⁺ is made; study it simulated "
                "with fewer pixels"
            )
        return StudyRoom(place.stem, tier_of(stored.calibration, transport, colour), 0.0, transport)
    scene = load_scene(place)
    scale = min(size[0] / scene.camera.height, size[1] / scene.camera.width)
    camera, projector = (
        (max(1, round(scale * device.height)), max(1, round(scale * device.width)))
        for device in (scene.camera, scene.projector)
    )
    return simulated_room(scene.resized(camera, projector), place.stem, colour)


def simulated_room(scene: Scene, name: str, colour: str = "auto") -> "StudyRoom":
    """Simulate a scene at its own size."""
    results, seconds = processor_seconds(lambda: [simulate(view) for view in scene.views])
    return StudyRoom(name, tier_of(*simulation.simulated_room(scene, results), colour), seconds)


class StudyRoom:
    """A room whose maps can be built with any options. Call close() at the end.

    The room keeps the last maps and the last bench, so methods that share them should follow each other.

    tier : calibration and transport in a tier of colour.
    simulation_s : processor seconds of its simulation.
    given : stored T of the user's own room, for white light; None for a scene.
    white : radiance of a white picture, as in the player.
    counts : the lit camera pixels, to which figures refer.
    inside : their T.
    lit : (projector pixels, 3). Whether near light leaves them.
    objective : the objective of the player's maps and refinement.
    box : the unweighted optimum.
    """

    def __init__(self, name: str, tier: Tier, simulation_s: float, given: Transport | None = None) -> None:
        self.name, self.tier, self.simulation_s, self.given = name, tier, simulation_s, given
        self.calibration, self.transport, self.white = tier.calibration, tier.transport, tier.white
        self.objective = objective_of(tier.transport, tier.calibration, DEFAULT_AIMS, tier.mixing)
        self.counts = self.objective.lit_picture(tier.calibration)
        self.inside = self.transport.inside(self.counts)
        self.lit, self.box = self.inside.lit, Box(self.objective.unweighted)
        self._built: tuple[InverseOptions, BuiltRoom | InputError, float] | None = None
        self._bench: tuple[object, Bench] | None = None

    @property
    def largest_cluster(self) -> int:
        """Projector pixels of the largest cluster of the uncut near light (green)."""
        return int(find_clusters(channel(self.inside.near, 1)).projector_sizes.max(initial=0))

    @property
    def largest_block(self) -> int:
        """Camera times projector pixels of the largest cluster of any channel."""
        found = [find_clusters(T) for T in channels(self.inside.near)]
        return max(int((each.camera_sizes * each.projector_sizes).max(initial=0)) for each in found)

    def build(self, options: InverseOptions) -> tuple[BuiltRoom, float]:
        """Returns the maps of counterlight build, without refinement maps, and processor seconds; keeps the last.

        Raises InputError if the maps cannot be built; a failure is kept too.
        """
        if self._built is None or self._built[0] != options:
            self.close()
            self._built = None
            self._built = options, *processor_seconds(lambda: self._build(options))
        _, built, seconds = self._built
        if isinstance(built, InputError):
            raise built
        return built, seconds

    def _build(self, options: InverseOptions) -> BuiltRoom | InputError:
        try:
            return build_maps(self.tier, options, refine=False, entry_bytes=ENTRY_BYTES)
        except InputError as error:
            return error

    def bench(self, key: object, maps: Callable[[], RoomMaps], start: str) -> Bench:
        """Returns the player with maps and a start of refinement; the last bench is kept under its key."""
        if self._bench is None or self._bench[0] != key:
            self.close()
            self._bench = key, Bench(Room(self.calibration, maps(), self.white, start=start))
        return self._bench[1]

    def close(self) -> None:
        """Release the player's resources."""
        if self._bench is not None:
            self._bench[1].close()
        self._bench = None

    @cached_property
    def refinement(self) -> tuple[RefinementMaps, float]:
        """The maps for refinement and direct mapping, and their processor seconds."""
        return processor_seconds(
            lambda: refinement_maps(self.objective, self.calibration.camera.shape, self.calibration.projector.shape)
        )

    @cached_property
    def direct(self) -> tuple[RowMap, float]:
        """Returns direct mapping as in thesis 6.1, without a prior, and the processor seconds that it took."""
        T, all_of_it = self.inside, np.ones((self.calibration.projector.pixels, 3))
        return processor_seconds(lambda: self._asking(direct_mapping(T.T, T.composition(), all_of_it)))

    @cached_property
    def triangulated(self) -> tuple[RowMap, float]:
        """Direct mapping to a fraction of a pixel, and its processor seconds."""
        camera, projector = self.calibration.camera.shape, self.calibration.projector.shape
        return processor_seconds(lambda: self._asking(triangulated_mapping(self.inside, camera, projector)))

    def _asking(self, rows: SparseRows) -> RowMap:
        """Returns a row map from the camera picture to the projector picture."""
        return pack(rows, self.calibration.projector.shape, self.calibration.camera.shape)

    def asking_for_all(self, correction: RowMap) -> RoomMaps:
        """Returns the maps for a player that shows b by one map; targets are limited to the light of full drive."""
        near, far, blurred = self._observed
        return RoomMaps(
            correction, near, far, None, self.white, mixing=self.tier.mixing, blurred=blurred, lit=self.counts
        )

    @cached_property
    def _observed(self) -> tuple[RowMap, MapChain | None, MapChain | None]:
        """Near, far and blurred light as the player reads them; None for absent light."""
        shapes, T = (self.calibration.camera.shape, self.calibration.projector.shape), self.transport
        far, blurred = (pack_chain(chain, *shapes) for chain in (T.far, T.blurred))
        return pack(T.near, *shapes), far, blurred


@dataclass(frozen=True)
class Judged:
    """The quality of a drive.

    seen : (camera height, camera width, 3), in screen primaries.
    below_optimum : decibels of PSNR below the box optimum.
    certified : upper bound of below_optimum from the gradient; may be infinite.
    """

    seen: FloatArray
    quality: Quality
    below_optimum: float
    certified: float


class Task:
    """One picture in one room.

    desired : (camera height, camera width, 3), in screen primaries.
    asked : b, (camera pixels, 3).
    counts : (camera pixels, 1). Whether lit.
    plain : (projector pixels, 3). The uncorrected picture.
    """

    def __init__(self, room: StudyRoom, picture: Picture) -> None:
        self.room, self.name = room, picture.name
        calibration = room.calibration
        self.desired = room.white * on_cameras(picture.at(calibration.placed_on), calibration)
        self.plain = picture.at(calibration.projector.shape).reshape(-1, 3)
        self.target = room.tier.target(self.desired)
        self.asked, self.counts = self.target.reshape(-1, 3), room.counts.reshape(-1, 1)

    @cached_property
    def optimum(self) -> tuple[FloatArray, float]:
        """The best drive in 0..1, (projector pixels, 3), and its processor seconds."""
        found, seconds = processor_seconds(lambda: self.room.box.solve(self.asked))
        return found.drive, seconds

    @cached_property
    def _best(self) -> Quality:
        return self._quality(self.room.tier.seen(self.optimum[0]))

    def judge(self, drive: FloatArray, *, any_exposure: bool = False) -> Judged:
        """Judge a drive through the undecomposed T, near and far light.

        drive : (projector pixels, 3), 0..1.
        any_exposure : use the camera exposure of least error.
        """
        seen = self.room.tier.seen(drive)
        certified = self.room.objective.unweighted.certificate(drive, self.asked).decibels
        if any_exposure:
            lit = self.room.counts
            light = seen[lit]
            seen = seen * float(np.vdot(light, self.desired[lit]) / (np.vdot(light, light) + TINY))
            certified = np.inf
        quality = self._quality(seen)
        return Judged(seen, quality, self._best.psnr - quality.psnr, certified)

    def clipped(self, unclamped: FloatArray) -> float:
        """Returns the share of the lit projector pixels' values outside 0..1.

        unclamped : (projector pixels, 3).
        """
        beyond = np.abs(unclamped - np.clip(unclamped, 0, 1)) > BEYOND
        return float(np.mean(beyond[self.room.lit])) if self.room.lit.any() else 0.0

    def _quality(self, seen: FloatArray) -> Quality:
        return measure(self.desired, seen, self.room.counts, self.room.white)

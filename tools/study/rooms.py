"""Where a study takes place: scenes and calibration folders as rooms, and a picture in a room as a task."""

import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from counterlight import calibration as calibrations
from counterlight import maps
from counterlight.calibration import StoredCalibration
from counterlight.content import reachable_white
from counterlight.errors import InputError
from counterlight.maps import RefinementMaps, RoomMaps
from counterlight.refinement import Certificate
from counterlight.room import Room
from counterlight.row_map import RowMap
from counterlight.tools.inverse.inverse import InverseOptions
from counterlight.tools.inverse.room import BuiltRoom, build_room_maps
from counterlight.tools.packing.refinement_maps import refinement_maps
from counterlight.tools.packing.row_maps import pack_matrices
from counterlight.tools.shipped import shipped_scenes
from counterlight.tools.simulation.room import write_simulated_room
from counterlight.tools.simulation.scene import Scene, load_scene
from counterlight.tools.simulation.simulate import simulate
from counterlight.tools.solve.box import certificate
from counterlight.tools.solve.quality import Quality, measure
from counterlight.tools.solve.registry import solve_channels
from counterlight.tools.solve.system import LinearSystem, channel_system
from counterlight.tools.study.frames import Bench
from counterlight.tools.study.pictures import Picture
from counterlight.tools.transport.storage import read_transport

FloatArray = NDArray[np.float64]
R = TypeVar("R")
BEYOND = 0.1 / 255  # drive; less than this outside 0..1 is rounding, not clipping


def processor_seconds(work: Callable[[], R]) -> tuple[R, float]:
    """What `work` returns and the processor time that it took, all cores together: other load hardly changes it."""
    start = time.process_time()
    result = work()
    return result, time.process_time() - start


def find_places(given: Sequence[Path], names: Sequence[str]) -> list[Path]:
    """Scene files and calibration folders to study: those given, those of shipped scenes by name, or all shipped ones.

    InputError for what is none of these, before the work begins.
    """
    shipped = shipped_scenes()
    unknown = [name for name in names if name not in shipped]
    if unknown:
        raise InputError(f"--scenes {unknown[0]}: no such scene is shipped; there are {', '.join(shipped)}")
    for path in given:
        if path.is_dir():
            calibrations.read(path)
        else:
            load_scene(path)
    places = [*given, *(shipped[name] for name in names)] or list(shipped.values())
    repeated = [path for path in places if [p.stem for p in places].count(path.stem) > 1]
    if repeated:
        raise InputError(f"{repeated[0]}: another room of this study is called {repeated[0].stem}, too; rename one")
    return places


def open_room(place: Path, folder: Path, size: tuple[int, int]) -> "StudyRoom":
    """A scene simulated into `folder`, its camera fitted into `size` (height, width), or a copy of a calibration.

    The projector is scaled as the camera is. Calibrations are copied, so that their own correction/ stays as it is.
    """
    target = folder / place.stem
    if place.is_dir():
        shutil.copytree(place, target, ignore=shutil.ignore_patterns(maps.FOLDER))
        return StudyRoom(place.stem, calibrations.read(target), 0.0)
    scene = load_scene(place)
    scale = min(size[0] / scene.camera.height, size[1] / scene.camera.width)
    camera, projector = (
        (max(1, round(scale * device.height)), max(1, round(scale * device.width)))
        for device in (scene.camera, scene.projector)
    )
    return simulated_room(resized(scene, camera, projector), target, place.stem)


def resized(scene: Scene, camera: tuple[int, int], projector: tuple[int, int]) -> Scene:
    """With other pixels, (height, width) each; the horizontal fields of view stay."""
    return replace(scene, camera=scene.camera.resized(*camera), projector=scene.projector.resized(*projector))


def simulated_room(scene: Scene, target: Path, name: str) -> "StudyRoom":
    """Simulate into a folder that does not exist yet."""
    result, seconds = processor_seconds(lambda: simulate(scene))
    write_simulated_room(scene, result, target)
    return StudyRoom(name, calibrations.read(target), seconds)


class StudyRoom:
    """A room whose maps can be built with any options.

    simulation_s : processor seconds of its simulation.  white : radiance of a white picture, as the player takes it.
    systems : of the three channels, with no target yet.  lit : (projector pixels, 3), whether near light leaves them.
    Holds the last maps and the last bench, so methods that share them should follow each other; close() at the end.
    """

    def __init__(self, name: str, stored: StoredCalibration, simulation_s: float) -> None:
        self.name, self.stored, self.simulation_s = name, stored, simulation_s
        self.calibration = stored.calibration
        self.transport = read_transport(stored)
        flood = self.transport.composition().reshape(self.calibration.ambient.shape) + self.calibration.ambient
        self.white = reachable_white(flood, self.calibration.mask)
        mask = self.calibration.mask.ravel()
        nothing = np.zeros(mask.size)
        self.systems = [channel_system(self.transport, i, nothing, mask) for i in range(3)]
        self.lit = np.stack([np.bincount(s.near.indices, minlength=s.shape[1]) > 0 for s in self.systems], axis=1)
        self._built: tuple[InverseOptions, BuiltRoom, float] | None = None
        self._bench: tuple[object, Bench] | None = None

    @property
    def largest_cluster(self) -> int:
        """Projector pixels of the largest cluster of the uncut near light (green)."""
        return int(self.systems[1].clusters.projector_sizes.max(initial=0))

    def build(self, options: InverseOptions) -> tuple[BuiltRoom, float]:
        """The maps as counterlight build makes them, refinement's apart, and processor seconds; the last is kept."""
        if self._built is None or self._built[0] != options:
            self.close()
            self._built = None
            built, seconds = processor_seconds(lambda: build_room_maps(self.stored, options, refine=False))
            self._built = options, built, seconds
        return self._built[1:]

    def bench(self, key: object, maps: Callable[[], RoomMaps], start: str) -> Bench:
        """The player with maps and a start of refinement; the one made last is kept for its key."""
        if self._bench is None or self._bench[0] != key:
            self.close()
            self._bench = key, Bench(Room(self.calibration, maps(), self.white, start=start))
        return self._bench[1]

    def close(self) -> None:
        """Release what the player holds."""
        if self._bench is not None:
            self._bench[1].close()
        self._bench = None

    @cached_property
    def refinement(self) -> tuple[RefinementMaps, float]:
        """What refinement and direct mapping need, and its processor seconds."""
        return processor_seconds(lambda: refinement_maps(self.transport, self.calibration))

    @cached_property
    def near_map(self) -> RowMap:
        """The near light as the player reads it."""
        return pack_matrices(self.transport.near, self.calibration.camera.shape, self.calibration.projector.shape)


@dataclass(frozen=True)
class Judged:
    """How good a drive is.

    seen : (camera height, camera width, 3), radiance.  below_optimum : decibels of PSNR to the box optimum.
    certified : decibels that it can be below the optimum at most, from its gradient alone.
    """

    seen: FloatArray
    quality: Quality
    below_optimum: float
    certified: float


class Task:
    """One picture in one room.

    desired : (camera height, camera width, 3), radiance.  plain : (projector pixels, 3), the picture uncorrected.
    """

    def __init__(self, room: StudyRoom, picture: Picture) -> None:
        self.room, self.name = room, picture.name
        calibration = room.calibration
        self.desired = room.white * picture.at(calibration.camera.shape)
        self.plain = picture.at(calibration.projector.shape).reshape(-1, 3)
        self.target = (self.desired - calibration.ambient).astype(np.float64)
        asked = self.target.reshape(-1, 3) * calibration.mask.ravel()[:, None]
        self.systems: list[LinearSystem] = [
            replace(system, target=asked[:, i].copy()) for i, system in enumerate(room.systems)
        ]

    @cached_property
    def optimum(self) -> tuple[FloatArray, float]:
        """The best drive in 0..1, (projector pixels, 3), and its processor seconds."""
        found, seconds = processor_seconds(lambda: solve_channels("box", self.systems))
        return np.stack([each.drive for each in found], axis=1), seconds

    @cached_property
    def _best(self) -> Quality:
        return self._quality(self.optimum[0])[1]

    def judge(self, drive: FloatArray) -> Judged:
        """Through the undecomposed T, near and far light; drive : (projector pixels, 3), 0..1."""
        seen, quality = self._quality(drive)
        found = [certificate(system, drive[:, i]) for i, system in enumerate(self.systems)]
        bound = Certificate(np.array([2 * each.objective for each in found]), np.array([each.gap for each in found]))
        return Judged(seen, quality, self._best.psnr - quality.psnr, bound.decibels)

    def clipped(self, unclamped: FloatArray) -> float:
        """Share of the lit projector pixels' values beyond 0..1; unclamped : (projector pixels, 3)."""
        beyond = np.abs(unclamped - np.clip(unclamped, 0, 1)) > BEYOND
        return float(np.mean(beyond[self.room.lit])) if self.room.lit.any() else 0.0

    def _quality(self, drive: FloatArray) -> tuple[FloatArray, Quality]:
        calibration = self.room.calibration
        seen = self.room.transport.apply(drive).reshape(self.desired.shape) + calibration.ambient
        return seen, measure(self.desired, seen, calibration.mask, self.room.white)

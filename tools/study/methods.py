"""Methods that compute a drive, each a small object: family, knob and value, how to prepare it, and how to drive.

To add a method, add an object to `catalogue`: figures, plots and advice follow from it.
"""

from collections.abc import Callable, Hashable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.errors import InputError
from counterlight.maps.room_maps import RoomMaps
from counterlight.maps.row_map import RowMap
from counterlight.pipeline.refinement import DEFAULT_STEPS
from counterlight.tools.inverse.method import LARGEST_DENSE
from counterlight.tools.inverse.near_light import InverseOptions
from counterlight.tools.solve import solution
from counterlight.tools.solve.box import Box
from counterlight.tools.solve.clusterwise import LARGEST_BLOCK
from counterlight.tools.solve.registry import SOLVERS
from counterlight.tools.study.frames import Bench
from counterlight.tools.study.rooms import StudyRoom, Task, processor_seconds

NNLS_STEPS = 200  # steps for clusters too large to pivot; only drives far above 1, clamped anyway, need more
STEPS = (1, 2, 4, 8, 16, 32, 64)
DIRECT_STEPS = (4, 16, 64)
CUT_STEPS = (1, 4, 16, 64)
MAX_CLUSTERS = (50, 200, 1000)
MAX_ERRORS = (2.0, 8.0, 32.0)  # values of --max-error besides the default
DAMPINGS = (0.01, 0.03, 0.1, 0.3)
UNCUT = "T⁺"
DEFAULTS = InverseOptions(inverse="whole")
THESIS = InverseOptions(inverse="thesis")  # clusters of at most 200


@dataclass(frozen=True)
class Drive:
    """The drive of a method for one picture.

    drive : (projector pixels, 3), 0..1.
    clipped : share of the lit values that the method wanted outside 0..1.
    any_exposure : whether the camera's exposure is chosen for the least error.
    """

    drive: FloatArray
    clipped: float
    any_exposure: bool = False


@dataclass(frozen=True)
class Prepared:
    """A method ready for pictures.

    preparation_s : processor seconds.
    map_bytes : size of all row maps that a frame reads; None without maps.
    bound : certified change of a pixel's drive by truncation and rounding of the map; None without a map.
    drive : returns a task's drive.
    cpu_s : returns a solver's processor seconds for a task's picture; None for methods of the player.
    frame_s : returns the player's seconds per frame for the picture driven last; None for a solver.
    """

    preparation_s: float
    map_bytes: int | None
    bound: float | None
    drive: Callable[[Task], Drive]
    cpu_s: Callable[[Task], float | None]
    frame_s: Callable[[], float | None]


class Method(Protocol):
    """A way to compute drives.

    family, knob, value : position in the plots.
    command : the commands with which a user gets the same result.
    made : key of the prepared data; methods with the same key share it.
    """

    @property
    def family(self) -> str: ...
    @property
    def knob(self) -> str: ...
    @property
    def value(self) -> float | None: ...
    @property
    def command(self) -> str: ...
    @property
    def made(self) -> Hashable: ...

    def prepare(self, room: StudyRoom) -> Prepared:
        """Raises InputError, in one line, if the method does not suit the room."""


@dataclass(frozen=True)
class Uncompensated:
    """The picture as any player would show it."""

    family: str = "uncompensated"
    knob: str = ""
    value: float | None = None
    command: str = "counterlight build --inverse none; counterlight play --no-compensation"
    made: str = "direct"

    def prepare(self, room: StudyRoom) -> Prepared:
        player = _direct_bench(room, DIRECT.family, room.direct[0]).player

        def drive(task: Task) -> Drive:
            player.show(task.desired, compensate=False, steps=0)  # only for its time
            return Drive(task.plain, 0.0, any_exposure=True)

        return Prepared(0.0, None, None, drive, lambda task: None, player.frame_s)


@dataclass(frozen=True)
class Direct:
    """Direct mapping (thesis 6.1): a map with one entry per pixel, or with three if `triangulated`."""

    family: str = "direct"
    triangulated: bool = False
    knob: str = ""
    value: float | None = None
    made: str = "direct"

    @property
    def command(self) -> str:
        return f"counterlight compensate --solver {'triangulated' if self.triangulated else 'direct'}"

    def prepare(self, room: StudyRoom) -> Prepared:
        mapped, seconds = room.triangulated if self.triangulated else room.direct
        return _prepared(_direct_bench(room, self.family, mapped), 0, seconds, mapped.nbytes, None)


@dataclass(frozen=True)
class Map:
    """The correction map of counterlight build, followed by steps of refinement in the player.

    start : start of refinement, "map" or "direct".
    """

    family: str
    knob: str
    value: float | None
    options: InverseOptions = DEFAULTS
    steps: int = 0
    start: str = "map"

    @property
    def made(self) -> Hashable:
        return self.options

    @property
    def command(self) -> str:
        words = [f"--max-error {self.options.max_error:g}"] if self.options.max_error != DEFAULTS.max_error else []
        if self.options.damping is not None:
            words.append(f"--regularize {self.options.damping:g}" if self.options.damping else "--regularize none")
        if self.options.inverse != "auto":
            words.append(f"--inverse {self.options.inverse}")
        if self.options.max_cluster is not None:
            words.append(f"--max-cluster {self.options.max_cluster}")
        start = f" --refine-from {self.start}" if self.steps else ""
        return f"{' '.join(['counterlight build', *words])}; counterlight play --refine {self.steps}{start}"

    def prepare(self, room: StudyRoom) -> Prepared:
        if self.options.damping == 0 and self.options.max_cluster is None and room.largest_cluster > LARGEST_DENSE:
            raise InputError(
                f"the plain pseudo-inverse of an uncut cluster of {room.largest_cluster} projector pixels takes "
                f"minutes; here it is tried up to {LARGEST_DENSE}"
            )
        built, seconds = room.build(self.options)
        refinement, further = room.refinement
        maps, bound = replace(built.maps, refinement=refinement), float(built.inverse.truncation.max(initial=0.0))
        size = frame_bytes(maps, self.steps, self.start)
        bench = room.bench((self.options, self.start), lambda: maps, self.start)
        if self.steps:
            return _prepared(bench, self.steps, seconds + further, size, None)
        return _prepared(bench, 0, seconds, size, bound)


@dataclass(frozen=True)
class Solver:
    """One picture at a time on the CPU (thesis 4.2.4), with the undecomposed T."""

    name: str
    family: str
    knob: str = ""
    value: float | None = None

    @property
    def made(self) -> Hashable:
        return self.name

    @property
    def command(self) -> str:
        return f"counterlight compensate --solver {self.name}"

    def prepare(self, room: StudyRoom) -> Prepared:
        solver, preparation_s = processor_seconds(lambda: self._solver(room))
        seconds: dict[str, float] = {}

        def drive(task: Task) -> Drive:
            if self.name == "box":
                best, seconds[task.name] = task.optimum
                return Drive(best, 0.0)
            found, seconds[task.name] = processor_seconds(lambda: solver.solve(task.asked * task.counts))
            return Drive(found.drive, task.clipped(found.unclamped))

        return Prepared(preparation_s, None, None, drive, lambda task: seconds[task.name], lambda: None)

    def _solver(self, room: StudyRoom) -> solution.Solver:
        if self.name == "box":
            return room.box
        if self.name == "nnls" and (room.inside.far is not None or room.largest_block > LARGEST_BLOCK):
            return Box(room.inside, np.inf, most_steps=NNLS_STEPS)
        return SOLVERS[self.name](room.inside)


DIRECT, TRIANGULATED = Direct(), Direct("direct, triangulated", triangulated=True)
OURS = Map("refined from T⁺", "steps", DEFAULT_STEPS, steps=DEFAULT_STEPS)
CUT = Map("refined from T⁺, cut", "steps", 4, InverseOptions(max_cluster=200), steps=4)
PLAIN = Map("T⁺ of the thesis", "max-cluster", THESIS.largest, THESIS)


def catalogue() -> list[Method]:
    """Returns all methods that invert the uncut transport at most once; methods that share a map are neighbours."""
    methods: list[Method] = [Solver("box", "box optimum"), Solver("nnls", "NNLS"), Uncompensated()]
    methods += [DIRECT, TRIANGULATED, Map(UNCUT, "max-error", DEFAULTS.max_error)]
    methods += [replace(OURS, value=steps, steps=steps) for steps in STEPS]
    methods += [Map("T⁺, cut", "max-cluster", size, InverseOptions(max_cluster=size)) for size in (50, 1000, 200)]
    methods += [replace(CUT, value=steps, steps=steps) for steps in CUT_STEPS]
    methods += [
        replace(CUT, family="refined from direct", value=steps, steps=steps, start="direct") for steps in DIRECT_STEPS
    ]
    return [*methods, PLAIN, Map("T⁺ plain", "", None, InverseOptions(0.0))]


def uncut_knobs() -> list[Method]:
    """Returns the knobs that invert the uncut transport once more each, and the thesis' cut of T at other sizes."""
    methods: list[Method] = [
        Map(UNCUT, "max-error", error, InverseOptions(max_error=error, inverse="whole")) for error in MAX_ERRORS
    ]
    methods += [
        Map("T⁺, λ given", "regularize", damping, InverseOptions(damping, inverse="whole")) for damping in DAMPINGS
    ]
    sizes = [size for size in MAX_CLUSTERS if size != PLAIN.value]
    return methods + [replace(PLAIN, value=size, options=replace(THESIS, max_cluster=size)) for size in sizes]


def frame_bytes(maps: RoomMaps, steps: int, start: str) -> int:
    """Returns the bytes of the row maps that a frame reads."""
    read = {"direct"} if steps and start == "direct" else {".", "undo_gather", "undo_mix"}
    if maps.undo is not None:
        read |= {"far_scatter"}
    if steps:
        read |= {"transport", "far_gather", "far_mix", "far_scatter"}
        read |= {"dual", "dual_gather", "dual_mix", "dual_scatter"}
    return sum(packed.nbytes for name, packed in maps.named().items() if name in read)


def _prepared(bench: Bench, steps: int, preparation_s: float, size: int, bound: float | None) -> Prepared:
    """Returns a method of the player that compensates with `steps` steps."""

    def drive(task: Task) -> Drive:
        found = bench.player.show(task.desired, compensate=True, steps=steps)
        return Drive(found, 0.0 if steps else task.clipped(bench.T_pinv.apply(task.target).reshape(-1, 3)))

    return Prepared(preparation_s, size, bound, drive, lambda task: None, bench.player.frame_s)


def _direct_bench(room: StudyRoom, family: str, mapped: RowMap) -> Bench:
    """Returns a bench of direct mapping, which divides by all light, so that no light is subtracted before."""
    return room.bench(family, lambda: room.asking_for_all(mapped), "map")

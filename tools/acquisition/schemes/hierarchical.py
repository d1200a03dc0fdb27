"""Scene-adaptive hierarchical acquisition of the light transport (thesis 3.4.2; Sen et al. 2005, Dual Photography).

From the floodlit room down: a block of projector pixels that a camera pixel measurably sees is cut into four, and its
quarters are shown one after the other. Blocks that no camera pixel sees together are cut at the same time. Light is
kept at the last level at which it could be measured. What is kept at coarse levels still lights every later capture,
since many blocks are lit at once: its prediction is subtracted before a camera pixel is read (the far light of all
blocks of one pattern together can be far above the threshold that each stayed below).

Where pictures are captured several times, blocks of side s are so 1/√s as often. What a block's noise does to T is
spread over its area, so that 1/s² would do for blocks that are cut; but a lower threshold finds more to cut.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from counterlight.arrays import FloatArray, IntArray
from counterlight.errors import InputError
from counterlight.tools.acquisition.plan import Captures, LazyPatterns, Level, Measured, Pattern, Reference, Scheme
from counterlight.tools.acquisition.schemes.agreement import Reading, agree, keep_measurable
from counterlight.tools.acquisition.schemes.blocks import (
    NO_CHILD,
    BlockGrid,
    BlockLight,
    KnownLight,
    as_transport,
    grids,
)
from counterlight.tools.acquisition.schemes.schedule import colour_graph, conflict_graph

QUARTERS = 4


@dataclass(frozen=True)
class Threshold:
    """τ: what a camera pixel must rise by in some channel to count as lit.

    sigmas : τ as a multiple of the measured noise.  absolute : τ as radiance, instead.
    """

    sigmas: float = 4.0
    absolute: float | None = None

    def __post_init__(self) -> None:
        if not 0 < self.sigmas < float("inf"):
            raise InputError(f"--threshold {self.sigmas:g}: expected a multiple of the noise above 0, such as 4")
        if self.absolute is not None and not 0 < self.absolute < float("inf"):
            raise InputError(f"--threshold {self.absolute:g}: expected a radiance above 0")

    def of(self, room: Reference, background: FloatArray | float = 0.0) -> FloatArray:
        """τ of a capture in which known light shines: `background` (…, 3) -> (…, 3)."""
        if self.absolute is not None:
            return np.full(3, self.absolute)
        return self.sigmas * room.noise.sigma(np.asarray(background, np.float64))


DEFAULT = Threshold()


@dataclass(frozen=True)
class Quarters:
    """What a level shows: pattern i lights quarter `quarter[i]` of the blocks of colour `colour[i]`.

    blocks : the parents by colour.
    """

    grid: BlockGrid
    blocks: Sequence[IntArray]
    colour: IntArray
    quarter: IntArray

    def paint(self, index: int) -> Pattern:
        children = self.grid.children[self.blocks[self.colour[index]], self.quarter[index]]
        return BlockGrid(self.grid.projector, self.grid.side // 2).paint(children[children != NO_CHILD])


@dataclass(frozen=True)
class HierarchicalScheme:
    """The plain scheme; call it with a room and a projector's (height, width)."""

    threshold: Threshold = DEFAULT

    def __call__(self, room: Reference, projector: tuple[int, int]) -> Scheme:
        levels = grids(projector)
        known = KnownLight(len(room.light))
        root = active = floodlit_block(room, levels[0], self.threshold)
        before = room
        notes, readings = [], []
        for depth, grid in enumerate(levels[1:], 1):
            schedule = schedule_quarters(active)
            name = f"blocks of {grid.side} px"
            patterns = LazyPatterns(len(schedule.colour), schedule.paint)
            captures = yield Level(name, patterns, len(levels) - 1 - depth, cover=1, share=grid.side**-0.5)
            now = room.averaged(captures.repeats)
            reading = self._read(now, before, active, schedule, captures, known)
            before = now
            active, settled = keep_measurable(active, np.maximum(reading.light, 0), reading.lit, reading.rest)
            for part in settled:
                known.add(part)
            readings.append(reading)
            notes.append(f"{name}: {len(patterns)} pictures, {active.camera.size} connections measured")
        variance = (room.noise.sigma(root.light) ** 2 + room.noise.dark**2) / room.repeats
        parts = agree(root, variance, readings)
        return Measured(as_transport(parts, len(room.light)), tuple(notes))

    def _read(
        self,
        room: Reference,
        before: Reference,
        parents: BlockLight,
        schedule: Quarters,
        captures: Captures,
        known: KnownLight,
    ) -> Reading:
        """Read the quarters' light off the captures, and what of it is measurable.

        room, before : of these captures, and of those that the parents were read off.
        """
        colour_of = np.zeros(parents.grid.count, np.int64)
        for colour, blocks in enumerate(schedule.blocks):
            colour_of[blocks] = colour
        order = np.argsort(colour_of[parents.block], kind="stable")
        ends = np.searchsorted(colour_of[parents.block][order], np.arange(len(schedule.blocks) + 1))
        exists = parents.grid.children[parents.block] != NO_CHILD
        quarters = np.zeros((parents.camera.size, QUARTERS, 3), np.float32)
        variance = np.zeros((parents.camera.size, QUARTERS, 3), np.float32)
        lit = np.zeros((parents.camera.size, QUARTERS), np.bool_)
        for index, (colour, quarter) in enumerate(zip(schedule.colour, schedule.quarter, strict=True)):
            entries = order[ends[colour] : ends[colour + 1]]
            entries = entries[exists[entries, quarter]]
            camera = parents.camera[entries]
            background = known.seen(schedule.paint(index))
            light = (room.above_black(captures[index]) - background)[camera]
            quarters[entries, quarter] = light
            variance[entries, quarter] = room.noise.sigma(np.maximum(light, 0) + background[camera]) ** 2
            lit[entries, quarter] = np.any(light >= self.threshold.of(room, background[camera]), axis=1)
        # A parent and the sum of its quarters both have noise.
        tau = np.hypot(*(self.threshold.of(each, parents.light) for each in (before, room)))
        rest = parents.light - np.sum(np.maximum(quarters, 0) * lit[..., None], axis=1)
        return Reading(quarters, variance, lit, np.any(rest >= tau, axis=1))


def floodlit_block(room: Reference, grid: BlockGrid, threshold: Threshold) -> BlockLight:
    """Level 0: the camera pixels that the floodlight raises by τ."""
    camera = np.flatnonzero(np.any(room.light >= threshold.of(room), axis=1))
    return BlockLight(grid, camera, np.zeros_like(camera), np.maximum(room.light[camera], 0))


def schedule_quarters(parents: BlockLight) -> Quarters:
    """Colour the conflict graph of the blocks that are seen, and show the quarters of each colour in turn."""
    used, local = np.unique(parents.block, return_inverse=True)
    colours = colour_graph(conflict_graph(parents.camera, local, used.size))
    blocks = [used[colours == colour] for colour in range(colours.max(initial=-1) + 1)]
    exists = parents.grid.children != NO_CHILD
    shown = np.array([exists[members].any(axis=0) for members in blocks]).reshape(-1, QUARTERS)
    colour, quarter = np.nonzero(shown)
    return Quarters(parents.grid, blocks, colour, quarter)

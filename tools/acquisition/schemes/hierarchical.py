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
from numpy.typing import NDArray

from counterlight import memory
from counterlight.arrays import BoolArray, FloatArray, IntArray
from counterlight.errors import InputError
from counterlight.tools.acquisition.plan import (
    Captures,
    LazyPatterns,
    Level,
    Measured,
    Noise,
    Pattern,
    Reference,
    Scheme,
)
from counterlight.tools.acquisition.schemes.agreement import Reading, agree, keep_measurable, parts_of
from counterlight.tools.acquisition.schemes.blocks import (
    NO_CHILD,
    BlockGrid,
    BlockLight,
    as_transport,
    grids,
)
from counterlight.tools.acquisition.schemes.known import KnownLight, Quarter
from counterlight.tools.acquisition.schemes.schedule import colour_graph, conflict_graph

QUARTERS = 4
BYTES_A_PARENT = 4 * (24 + 1 + 20) + 9  # its quarters' light, variance and mark, and what may become of them; its order
FEWER = "give a higher --threshold, or let the camera give smaller pictures"


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

    def noise(self, room: Reference) -> Noise:
        """τ as the standard deviation of a noise."""
        if self.absolute is not None:
            return Noise(np.full(3, self.absolute), np.zeros(3))
        return Noise(self.sigmas * room.noise.dark, self.sigmas**2 * room.noise.gain)

    def of(self, room: Reference, background: NDArray[np.floating] | float = 0.0) -> FloatArray:
        """τ of a capture in which known light shines: `background` (…, 3) -> (…, 3)."""
        return self.noise(room).sigma(np.asarray(background, np.float64))


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
        known = KnownLight(len(room.light), projector)
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
            active, settled = keep_measurable(active, reading.light, reading.lit, reading.rest)
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
        memory.check(BYTES_A_PARENT * parents.camera.size, f"reading {parents.camera.size} connections", FEWER)
        order = np.argsort(colour_of[parents.block], kind="stable")
        ends = np.searchsorted(colour_of[parents.block], np.arange(len(schedule.blocks) + 1), sorter=order)
        exists = parents.grid.children != NO_CHILD
        shape = parents.camera.size, QUARTERS
        quarters, variance = (np.zeros((*shape, 3), np.float32) for _ in range(2))
        lit, least = np.zeros(shape, np.bool_), self.threshold.noise(room)
        for index, (colour, quarter) in enumerate(zip(schedule.colour, schedule.quarter, strict=True)):
            entries = order[ends[colour] : ends[colour + 1]]
            entries = entries[exists[parents.block[entries], quarter]]
            to = Quarter(parents.camera, entries, quarters[:, quarter], variance[:, quarter], lit[:, quarter])
            known.read(schedule.paint(index), captures[index], room.black, room.noise, least, to)
        return Reading(quarters, variance, lit, self._rest(room, before, parents, quarters, lit))

    def _rest(
        self,
        room: Reference,
        before: Reference,
        parents: BlockLight,
        quarters: NDArray[np.float32],
        lit: BoolArray,
    ) -> BoolArray:
        """Whether what the lit quarters leave of each parent is measurable: a parent and their sum both have noise."""
        found = np.zeros(parents.camera.size, np.bool_)
        for part in parts_of(found.size):
            light = parents.light[part]
            tau = np.hypot(*(self.threshold.of(each, light) for each in (before, room)))
            rest = light - np.sum(np.maximum(quarters[part], 0) * lit[part, :, None], axis=1)
            found[part] = np.any(rest >= tau, axis=1)
        return found


def floodlit_block(room: Reference, grid: BlockGrid, threshold: Threshold) -> BlockLight:
    """Level 0: the camera pixels that the floodlight raises by τ."""
    camera = np.flatnonzero(np.any(room.light >= threshold.of(room), axis=1)).astype(np.int32)
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

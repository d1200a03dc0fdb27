"""Scene-adaptive hierarchical acquisition of the light transport (thesis 3.4.2; Sen et al. 2005, Dual Photography).

The scheme starts from the floodlit room. A block of projector pixels that a camera pixel measurably sees is divided
into four quarters, which are shown one after the other. Blocks that no camera pixel sees together are divided at the
same time. Light is kept at the last level at which it could be measured. Light kept at coarse levels still shines in
every later capture, because many blocks are lit at once, and together it can exceed the threshold. Its prediction is
therefore subtracted before a camera pixel is read.

Where pictures are captured several times, blocks of side s are captured in proportion to 1/√s. A block's noise in T is
spread over its area, so 1/s² would do for blocks that are divided; but a lower threshold finds more to divide.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property, partial, reduce
from operator import add
from pathlib import Path
from tempfile import gettempdir

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from counterlight import memory
from counterlight.arrays import BoolArray, FloatArray, IntArray
from counterlight.command import track
from counterlight.errors import InputError
from counterlight.tools.acquisition.plan import (
    Captures,
    Expected,
    LazyPatterns,
    Level,
    Measured,
    Noise,
    Pattern,
    Reference,
    Scheme,
)
from counterlight.tools.acquisition.schemes.agreement import Reading, agree, parts_of
from counterlight.tools.acquisition.schemes.bands import PIXELS, SIDE_BY_SIDE, Band, at_once, drained, in_turn
from counterlight.tools.acquisition.schemes.blocks import (
    NO_CHILD,
    BlockGrid,
    BlockLight,
    Seen,
    grids,
    is_wide,
    together,
    with_readable_far,
)
from counterlight.tools.acquisition.schemes.known import Quarter
from counterlight.tools.acquisition.schemes.schedule import colour_graph, conflict_graph
from counterlight.tools.acquisition.schemes.smooth import smoothed

QUARTERS = 4
USUAL = 32  # pictures assumed per level in advance
GROWTH = 0.8, 2.0  # least and most growth from a level to the next
ONE_BY_ONE = 2  # growth after a level whose blocks were shown one by one
# shares of the floodlight: a block below FAINT is divided only if its quarters differ by more than UNEVEN
FAINT, UNEVEN = 0.03, 0.001
# bytes of a divided block: light, variance and mark of its quarters, their successors, and its order
BYTES_A_PARENT = 4 * (24 + 1 + 20) + 9
FEWER = "give a higher --threshold, or let the camera give smaller pictures"


@dataclass(frozen=True)
class Threshold:
    """τ: the rise in some channel from which a camera pixel counts as lit.

    sigmas : τ as a multiple of the measured noise.
    absolute : τ as radiance; replaces `sigmas`.
    """

    sigmas: float = 4.0
    absolute: float | None = None

    def __post_init__(self) -> None:
        if not 0 < self.sigmas < float("inf"):
            raise InputError(f"--threshold {self.sigmas:g}: expected a multiple of the noise above 0, such as 4")
        if self.absolute is not None and not 0 < self.absolute < float("inf"):
            raise InputError(f"--threshold {self.absolute:g}: expected a radiance above 0")

    def noise(self, room: Reference) -> Noise:
        """Returns τ in the form of a noise."""
        if self.absolute is not None:
            return Noise(np.full(3, self.absolute), np.zeros(3))
        return Noise(self.sigmas * room.noise.dark, self.sigmas**2 * room.noise.gain)

    def of(self, room: Reference, background: NDArray[np.floating] | float = 0.0) -> FloatArray:
        """Returns τ of a capture that contains known light `background` (…, 3): (…, 3)."""
        return self.noise(room).sigma(np.asarray(background, np.float64))


DEFAULT = Threshold()


@dataclass(frozen=True)
class Quarters:
    """The patterns of a level: pattern i lights quarter `quarter[i]` of the blocks of colour `colour[i]`.

    blocks : the parents by colour.
    """

    grid: BlockGrid
    blocks: Sequence[IntArray]
    colour: IntArray
    quarter: IntArray

    def paint(self, index: int) -> Pattern:
        finer, lit = self.lit(index)
        return finer.paint(lit)

    def lit(self, index: int) -> tuple[BlockGrid, IntArray]:
        """Returns the grid of half the side, and the blocks that a pattern lights."""
        children = self.grid.children[self.blocks[self.colour[index]], self.quarter[index]]
        return BlockGrid(self.grid.projector, self.grid.side // 2), children[children != NO_CHILD]

    @cached_property
    def colour_of(self) -> NDArray[np.int32]:
        """The colour of each of the grid's blocks; 0 for unseen blocks."""
        colours = np.zeros(self.grid.count, np.int32)
        for colour, blocks in enumerate(self.blocks):
            colours[blocks] = colour
        return colours


@dataclass(frozen=True)
class HierarchicalScheme:
    """The hierarchical scheme; call it with a room and a projector's (height, width)."""

    threshold: Threshold = DEFAULT
    scratch: Path | None = None

    def expected(self, projector: tuple[int, int]) -> tuple[Expected, ...]:
        return tuple(Expected(min(grid.count, USUAL), _share(grid)) for grid in grids(projector)[1:])

    def __call__(self, room: Reference, projector: tuple[int, int]) -> Scheme:
        levels = grids(projector)
        bands = self._bands(room, levels[0])
        before = room
        notes, outlook = [], _Outlook()
        for depth, grid in enumerate(levels[1:], 1):
            schedule = schedule_quarters([band.active for band in bands])
            name = f"blocks of {grid.side} px"
            patterns = LazyPatterns(len(schedule.colour), schedule.paint)
            later = outlook.after(schedule, levels[depth + 1 :])
            captures = yield Level(name, patterns, later, cover=1, share=_share(grid))
            now = room.averaged(captures.repeats)
            self._read(now, before, bands, schedule, captures)
            before = now
            found = sum(band.active.camera.size for band in bands)
            notes.append(f"{name}: {len(patterns)} pictures, {found} connections measured")
        with ThreadPoolExecutor(SIDE_BY_SIDE) as threads:  # each band is freed once it is solved
            count, solved = len(bands), threads.map(partial(self._solved, room), drained(bands))
            seen = list(track(solved, "solving bands of the camera", count))
        transport = together(seen, projector)
        del seen  # frees memory: the variable is as large as T
        if is_wide(projector):
            height, width, _ = room.black.shape
            transport, note = smoothed(replace(transport, camera=(height, width), projector=projector))
            return Measured(transport, (*notes, note))
        return Measured(with_readable_far(transport), tuple(notes))

    def _bands(self, room: Reference, grid: BlockGrid) -> list[Band]:
        light, tau = room.light, self.threshold.of(room)
        parts = list(parts_of(len(light), PIXELS))
        scratch = self.scratch or Path(gettempdir())
        return [
            Band(part, floodlit_block(light[part], grid, tau), scratch if len(parts) > 1 else None) for part in parts
        ]

    def _solved(self, room: Reference, band: Band) -> Seen:
        root = band.root
        variance = (room.noise.sigma(root.light) ** 2 + room.noise.dark**2) / room.repeats
        parts = agree(root, variance, band.readings.taken())
        seen = Seen.of([replace(part, light=part.light.astype(np.float32)) for part in parts], band.count)
        del parts
        memory.give_back()
        return seen

    def _read(
        self, room: Reference, before: Reference, bands: Sequence[Band], schedule: Quarters, captures: Captures
    ) -> None:
        """Read the quarters' light from the captures, and settle the light that is not measurable.

        room, before : noise of these captures, and of the captures from which the parents were read.
        """
        for some in at_once(bands):
            self._settle(room, before, some, schedule, captures)
            memory.give_back()

    def _settle(
        self, room: Reference, before: Reference, bands: Sequence[Band], schedule: Quarters, captures: Captures
    ) -> None:
        found = self._found(room, bands, schedule, captures)

        def settle(band: Band) -> None:
            of_band = found.pop(band)
            if is_wide(schedule.grid.projector):
                of_band.lit &= ~self._even(room.light[band.pixels], band.active, of_band)[:, None]
            rest = self._rest(room, before, band.active, of_band.quarters, of_band.lit)
            band.settle(Reading(of_band.quarters, of_band.variance, of_band.lit, rest))

        with ThreadPoolExecutor(SIDE_BY_SIDE) as threads:
            list(threads.map(settle, bands))

    def _found(
        self, room: Reference, bands: Sequence[Band], schedule: Quarters, captures: Captures
    ) -> "dict[Band, _Found]":
        found = {band: _Found.of(band, schedule) for band in bands}
        least, black = self.threshold.noise(room), room.black.reshape(-1, 3)
        shown = zip(schedule.colour, schedule.quarter, in_turn(captures), strict=True)
        title = f"reading {sum(band.active.camera.size for band in bands)} connections off"
        for index, (colour, quarter, seen) in enumerate(track(shown, title, len(captures))):
            capture = seen.reshape(-1, 3)
            shares = bands[0].known.shares(*schedule.lit(index))
            for band, each in found.items():
                to = each.of_colour(colour, quarter)
                band.known.read(shares, capture[band.pixels], black[band.pixels], room.noise, least, to)
        return found

    def _even(self, flood: FloatArray, parents: BlockLight, found: "_Found") -> BoolArray:
        """Whether a parent is faint and its quarters show no significant difference, as for smooth far light.

        Most parents of a camera pixel give only such light.

        flood : (camera pixels, 3). T·1.
        """
        even, area = np.zeros(parents.camera.size, np.bool_), parents.grid.quarter_areas
        shares = area / area.sum(axis=1, keepdims=True)
        for part in parts_of(even.size):
            light, share = found.quarters[part].astype(np.float64), shares[parents.block[part]]
            whole, white = light.sum(axis=1), np.maximum(flood[parents.camera[part]], 0)
            off = np.abs(light - share[..., None] * whole[:, None])
            tau = np.maximum(self.threshold.sigmas * np.sqrt(found.variance[part]), UNEVEN * white[:, None])
            even[part] = np.all(whole <= FAINT * white, axis=1) & np.all(off <= tau, axis=(1, 2))
        return even

    def _rest(
        self,
        room: Reference,
        before: Reference,
        parents: BlockLight,
        quarters: NDArray[np.float32],
        lit: BoolArray,
    ) -> BoolArray:
        """Whether the remainder outside the lit quarters is measurable; parent and quarters both contribute noise."""
        found = np.zeros(parents.camera.size, np.bool_)
        for part in parts_of(found.size):
            light = parents.light[part]
            tau = np.hypot(*(self.threshold.of(each, light) for each in (before, room)))
            rest = light - np.sum(np.maximum(quarters[part], 0) * lit[part, :, None], axis=1)
            found[part] = np.any(rest >= tau, axis=1)
        return found


class _Outlook:
    """Predicts the number of pictures of the following levels.

    The number is assumed to grow as it grew before. Where blocks had to be shown one by one, all conflict: either there
    are few blocks yet, or there is far light, for which smaller blocks are too faint.
    """

    def __init__(self) -> None:
        self._before = 0  # pictures of the previous level; 0 if its blocks were shown one by one

    def after(self, schedule: Quarters, finer: Sequence[BlockGrid]) -> tuple[Expected, ...]:
        """Returns the levels after this schedule; `finer` are their grids."""
        count, growth = len(schedule.colour), 1.0
        if all(blocks.size == 1 for blocks in schedule.blocks):
            self._before, following = 0, max(USUAL, ONE_BY_ONE * count)
        else:
            growth = float(np.clip(count / self._before, *GROWTH)) if self._before else 1.0
            self._before, following = count, round(count * growth)
        expected = list[Expected]()
        for grid in finer:
            expected.append(Expected(min(following, grid.count), _share(grid)))
            following = round(following * growth)
        return tuple(expected)


def _share(grid: BlockGrid) -> float:
    return float(grid.side**-0.5)


class _Found:
    """The quarters that a level's captures show of a band's parents.

    quarters, variance : (entries, 4, 3).
    lit : (entries, 4) bool. Whether the quarter is measurable.
    """

    def __init__(self, parents: BlockLight, order: IntArray, ends: IntArray) -> None:
        self._parents, self._order, self._ends = parents, order, ends
        self._exists = parents.grid.children != NO_CHILD
        shape = parents.camera.size, QUARTERS
        self.quarters, self.variance = (np.zeros((*shape, 3), np.float32) for _ in range(2))
        self.lit = np.zeros(shape, np.bool_)

    @classmethod
    def of(cls, band: Band, schedule: Quarters) -> "_Found":
        parents = band.active
        memory.check(BYTES_A_PARENT * parents.camera.size, f"reading {parents.camera.size} connections", FEWER)
        colours = schedule.colour_of[parents.block]
        order = np.argsort(colours, kind="stable")
        return cls(parents, order, np.searchsorted(colours, np.arange(len(schedule.blocks) + 1), sorter=order))

    def of_colour(self, colour: int, quarter: int) -> Quarter:
        """Returns one quarter of the blocks of a colour."""
        entries = self._order[self._ends[colour] : self._ends[colour + 1]]
        entries = entries[self._exists[self._parents.block[entries], quarter]]
        return Quarter(
            self._parents.camera, entries, self.quarters[:, quarter], self.variance[:, quarter], self.lit[:, quarter]
        )


def floodlit_block(light: FloatArray, grid: BlockGrid, tau: FloatArray) -> BlockLight:
    """Returns level 0: the camera pixels that the floodlight raises by τ. `light` is (camera pixels, 3)."""
    camera = np.flatnonzero(np.any(light >= tau, axis=1)).astype(np.int32)
    return BlockLight(grid, camera, np.zeros_like(camera), np.maximum(light[camera], 0))


def schedule_quarters(parents: Sequence[BlockLight]) -> Quarters:
    """Colour the conflict graph of the seen blocks of all bands, and show the quarters of each colour in turn."""
    grid = parents[0].grid
    used = np.flatnonzero(sum(np.bincount(band.block, minlength=grid.count) for band in parents))
    place = np.zeros(grid.count, np.int32)
    place[used] = np.arange(used.size)
    graph = reduce(add, (conflict_graph(band.camera, place[band.block], used.size) for band in parents))
    colours = colour_graph(sparse.csr_array(graph))
    blocks = [used[colours == colour] for colour in range(colours.max(initial=-1) + 1)]
    exists = grid.children != NO_CHILD
    shown = np.array([exists[members].any(axis=0) for members in blocks]).reshape(-1, QUARTERS)
    colour, quarter = np.nonzero(shown)
    return Quarters(grid, blocks, colour, quarter)

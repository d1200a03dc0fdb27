"""Acquisition: schedules, codes, and how well each scheme finds a known T."""

import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from scipy import sparse

from counterlight.errors import InputError
from counterlight.response import Response
from counterlight.tools.acquisition.cameras.camera import Exposures, Shot
from counterlight.tools.acquisition.cameras.live import LiveCamera
from counterlight.tools.acquisition.cameras.simulated import (
    CameraSettings,
    MemoryScreen,
    SimulatedCamera,
    SimulatedDevice,
    SimulatedRoom,
)
from counterlight.tools.acquisition.linearity import SHOTS
from counterlight.tools.acquisition.plan import REPEATS, Noise, measure_noise
from counterlight.tools.acquisition.ramps import light_level
from counterlight.tools.acquisition.schemes import blocks
from counterlight.tools.acquisition.schemes.agreement import Reading, agree, keep_measurable
from counterlight.tools.acquisition.schemes.blocks import (
    NO_CHILD,
    BlockGrid,
    BlockLight,
    as_transport,
    grids,
    sum_by_camera,
)
from counterlight.tools.acquisition.schemes.graycode import GrayCodeScheme, locate, stripes
from counterlight.tools.acquisition.schemes.hierarchical import HierarchicalScheme, Threshold
from counterlight.tools.acquisition.schemes.known import KnownLight, Quarter
from counterlight.tools.acquisition.schemes.multiplexed import MultiplexedScheme, code_length, s_inverse, s_matrix
from counterlight.tools.acquisition.schemes.schedule import colour_graph, conflict_graph
from counterlight.tools.simulation.devices import Sensor
from counterlight.tools.transport.transport import Transport, channel, channels
from tests.acquired_rooms import (
    NOISY,
    PROJECTOR,
    QUIET,
    SEEDS,
    SHAPE,
    error,
    mirror,
    room_of,
    run,
    sharp_wall,
    with_far_light,
)
from tests.studies.acquisition import relative_error
from tests.studies.baselines import FixedBlocksScheme, PixelByPixelScheme

# Blocks that may be lit together.


@settings(max_examples=100, deadline=None)
@given(seed=SEEDS)
def test_the_conflict_graph_is_every_pair_that_a_camera_pixel_sees(seed: int) -> None:
    rng = np.random.default_rng(seed)
    seen = rng.random((rng.integers(1, 20), rng.integers(1, 15))) < 0.2
    camera, block = np.nonzero(seen)
    expected = (seen.T.astype(int) @ seen > 0) & ~np.eye(seen.shape[1], dtype=bool)
    np.testing.assert_array_equal(conflict_graph(camera, block, seen.shape[1]).toarray() > 0, expected)


@settings(max_examples=100, deadline=None)
@given(seed=SEEDS)
def test_a_colouring_gives_no_neighbours_the_same_colour(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(0, 90))
    half = np.triu(rng.random((n, n)) < rng.random(), 1)
    graph = sparse.csr_array((half | half.T).astype(np.int8))
    colours = colour_graph(graph)
    assert not np.any((half | half.T) & (colours[:, None] == colours))
    assert set(colours) == set(range(len(set(colours))))
    assert colours.max(initial=-1) <= np.diff(graph.indptr).max(initial=0)  # Brooks' bound plus 1


def test_a_wall_of_overlapping_windows_needs_no_more_colours_than_a_window_has_blocks() -> None:
    row, column = np.mgrid[:20, :31]
    windows = [(row + i, column + j) for i in range(3) for j in range(3)]
    camera = np.tile(np.arange(row.size), 9)
    block = np.concatenate([(y * 33 + x).ravel() for y, x in windows])
    assert colour_graph(conflict_graph(camera, block, 22 * 33)).max() + 1 == 9


def test_more_colours_than_a_word_has_bits() -> None:
    graph = conflict_graph(np.zeros(150, int), np.arange(150), 150)
    assert sorted(colour_graph(graph)) == list(range(150))


# The quad-tree.


def test_blocks_divide_into_their_children() -> None:
    levels = grids(PROJECTOR)
    assert [level.count for level in levels] == [1, 4, 12, 48, 165, 630]
    for coarse, fine in pairwise(levels):
        parent = np.full(fine.count, -1)
        for block, children in enumerate(coarse.children):
            parent[children[children != NO_CHILD]] = block
        np.testing.assert_array_equal(parent[fine.labels], coarse.labels)
        np.testing.assert_array_equal(coarse.paint(np.array([1 % coarse.count])), coarse.labels == 1 % coarse.count)
        np.testing.assert_array_equal(coarse.area, np.bincount(coarse.labels.ravel()))


def known_parts(rng: np.random.Generator, cameras: int) -> list[BlockLight]:
    """Light of blocks of several sizes; camera pixels ascend, and some repeat."""
    parts = []
    for grid in grids(PROJECTOR)[1:5]:
        camera, block = np.sort(rng.integers(0, cameras, 60)), rng.integers(0, grid.count, 60)
        parts.append(BlockLight(grid, camera, block, rng.uniform(size=(60, 3)).astype(np.float32)))
    return parts


def test_what_is_known_adds_to_a_capture_as_much_as_its_blocks_are_lit(rng: np.random.Generator) -> None:
    known, parts, pattern = KnownLight(40, PROJECTOR), known_parts(rng, 40), rng.random(PROJECTOR) < 0.3
    expected = np.zeros((40, 3))
    for part in parts:
        known.add(part)
        lit = np.array([pattern[part.grid.labels == block].mean() for block in part.block])
        np.add.at(expected, part.camera, part.light * lit[:, None])
    np.testing.assert_allclose(known.seen(pattern), expected, rtol=1e-12)  # float64 sums of few terms


@pytest.mark.parametrize("repeated", [1, 1000])
def test_a_capture_is_read_above_black_and_what_is_known(repeated: int, rng: np.random.Generator) -> None:
    """One thread reads few entries. All cores read the repeated entries."""
    known, pattern = KnownLight(40, PROJECTOR), rng.random(PROJECTOR) < 0.3
    for part in known_parts(rng, 40):
        known.add(part)
    black, capture = rng.uniform(0, 0.1, (5, 8, 3)), rng.uniform(0, 2, (5, 8, 3)).astype(np.float32)
    noise, least = Noise(np.full(3, 0.1), np.full(3, 0.01)), Noise(np.full(3, 0.4), np.full(3, 0.16))
    camera, entries = (
        np.tile(rng.integers(0, 40, 25), repeated),
        np.flatnonzero(np.tile(np.arange(25) % 3 > 0, repeated)),
    )
    light, variance, lit = np.zeros((camera.size, 3), np.float32), np.zeros((camera.size, 3), np.float32), camera < 0
    shares = known.shares(BlockGrid(PROJECTOR, 1), np.flatnonzero(pattern))
    known.read(
        shares,
        capture.reshape(-1, 3),
        black.reshape(-1, 3),
        noise,
        least,
        Quarter(camera, entries, light, variance, lit),
    )
    background = known.seen(pattern)
    expected = ((capture - black).reshape(-1, 3) - background)[camera[entries]]
    np.testing.assert_allclose(light[entries], expected, atol=1e-6)  # float32 of numbers up to 2
    whole = np.maximum(expected, 0) + background[camera[entries]]
    np.testing.assert_allclose(variance[entries], noise.sigma(whole) ** 2, rtol=1e-6)
    np.testing.assert_array_equal(lit[entries], np.any(expected >= least.sigma(background[camera[entries]]), axis=1))
    assert 0 < lit.sum() < entries.size
    others = np.setdiff1d(np.arange(camera.size), entries)
    assert not light[others].any()
    assert not lit[others].any()


def test_connections_that_memory_cannot_hold_are_refused_with_what_helps(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("counterlight.memory.available_bytes", lambda: 1000.0)
    refused = r"reading \d+ connections needs about .* give a higher --threshold, or let the camera give smaller"
    with pytest.raises(InputError, match=refused):
        run(room_of(sharp_wall(rng)), HierarchicalScheme())


@settings(max_examples=50, deadline=None)
@given(seed=SEEDS)
def test_energy_is_kept_once(seed: int) -> None:
    """Quarters that add up to their parent keep the parent's light, whichever quarters are measurable."""
    rng = np.random.default_rng(seed)
    grid = grids(PROJECTOR)[rng.integers(0, 5)]
    block = rng.integers(0, grid.count, 40)
    quarters = rng.uniform(size=(40, 4, 3)) * (grid.children[block] != NO_CHILD)[..., None]
    parents = BlockLight(grid, np.arange(40), block, quarters.sum(axis=1))
    lit = (rng.random((40, 4)) < 0.5) & (grid.children[block] != NO_CHILD)
    measured, rest = keep_measurable(parents, quarters, lit, np.ones(40, bool))
    # float64 sums of four terms
    np.testing.assert_allclose(sum_by_camera([measured, *rest], 40), parents.light, rtol=1e-12)


def test_blocks_and_their_quarters_agree_as_least_squares_would_have_them(rng: np.random.Generator) -> None:
    """The estimate is compared with the normal equations of all 21 measurements of a tree of 4×4 pixels."""
    levels = grids((4, 4))
    blocks_of = [np.eye(grid.count)[grid.labels.ravel()].T for grid in levels]
    design = np.concatenate(blocks_of)
    true = rng.uniform(1, 2, (16, 3))
    variance = rng.uniform(0.5, 2, (21, 3)) * 1e-4
    seen = (design @ true + rng.normal(size=(21, 3)) * np.sqrt(variance)).astype(np.float32)
    variance = variance.astype(np.float32)
    weighed = zip(np.sqrt(variance.astype(float)).T, seen.T.astype(float), strict=True)
    expected = np.stack([np.linalg.lstsq(design / s[:, None], y / s, rcond=None)[0] for s, y in weighed], axis=1)
    readings = []
    for coarse, of in ((levels[0], slice(1, 5)), (levels[1], slice(5, 21))):
        lit = np.ones((coarse.count, 4), bool)
        measured = (each[of][coarse.children].astype(float) for each in (seen, variance))
        readings.append(Reading(*measured, lit, lit[:, 0]))
    root = BlockLight(levels[0], np.zeros(1, int), np.zeros(1, int), seen[:1].astype(float))
    parts = agree(root, variance[:1].astype(float), readings)
    finest = parts[-1]
    found = np.zeros((16, 3))
    found[finest.block] = finest.light
    np.testing.assert_allclose(found, expected, rtol=1e-9)  # float64 after float32 measurements that both share
    np.testing.assert_allclose(sum(part.light.sum(axis=0) for part in parts), expected.sum(axis=0), rtol=1e-9)


def test_light_of_blocks_acts_as_it_was_measured(rng: np.random.Generator) -> None:
    """Coarse blocks become far light; single pixels and blocks of four pixels next to them become near light."""
    camera, pixel = np.nonzero(rng.random((SHAPE[0], SHAPE[1])) < 0.02)
    row, column = np.divmod(pixel, PROJECTOR[1])
    quads = BlockGrid(PROJECTOR, 2)
    parts = [
        BlockLight(BlockGrid(PROJECTOR, 1), camera, pixel, rng.random((camera.size, 3))),
        BlockLight(quads, camera, row // 2 * quads.columns + column // 2, rng.random((camera.size, 3))),
    ]
    for grid in (BlockGrid(PROJECTOR, 16), BlockGrid(PROJECTOR, 8)):
        camera, block = np.nonzero(rng.random((SHAPE[0], grid.count)) < 0.5)
        parts.append(BlockLight(grid, camera, block, rng.random((camera.size, 3))))
    transport = as_transport(parts, SHAPE[0])
    assert transport.far is not None
    p = rng.random(SHAPE[1])
    expected = np.zeros((SHAPE[0], 3))
    for part in parts:
        mean = np.bincount(part.grid.labels.ravel(), p) / part.grid.area
        np.add.at(expected, part.camera, part.light * mean[part.block][:, None])
    # float32 entries of the near light
    np.testing.assert_allclose(transport.apply(np.repeat(p[:, None], 3, 1)), expected, rtol=1e-6)


def test_a_small_block_far_from_any_spot_goes_to_its_cell() -> None:
    quads, pixels, cells = (BlockGrid(PROJECTOR, side) for side in (2, 1, 4))
    one = np.ones((1, 3))
    spot = BlockLight(pixels, np.array([7]), np.array([0]), one)
    beside, away = (BlockLight(quads, np.array([7]), np.array([block]), one) for block in (1, 100))
    transport = as_transport([spot, beside, away], SHAPE[0])
    assert set(channel(transport.near, 0).indices) == {0, 2, 3, PROJECTOR[1] + 2, PROJECTOR[1] + 3}
    assert transport.far is not None
    row, column = 100 // quads.columns // 2, 100 % quads.columns // 2
    cell = cells.paint(np.array([row * cells.columns + column]))
    for lit, expected in ((cell, 3.0), (~cell, 0.0)):  # three channels of 1
        drive = np.repeat(lit.reshape(-1, 1), 3, axis=1).astype(float)
        far = transport.apply(drive) - Transport(transport.near).apply(drive)
        np.testing.assert_allclose(far[7].sum(), expected, rtol=1e-12)  # float64 sums of 16 terms


def test_a_block_that_many_see_is_split_so_that_its_row_fits_a_texture(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    parts = [
        BlockLight(grid, *np.nonzero(seen), rng.random((int(seen.sum()), 3)))
        for grid in (BlockGrid(PROJECTOR, 16), BlockGrid(PROJECTOR, 8))
        for seen in [rng.random((SHAPE[0], grid.count)) < 0.7]
    ]
    whole = as_transport(parts, SHAPE[0])
    monkeypatch.setattr(blocks, "MOST_READ", 50)
    split = as_transport(parts, SHAPE[0])
    assert split.far is not None
    assert max(np.diff(U.tocsc().indptr).max() for U in channels(split.far.scatter)) <= 50
    drive = rng.random((SHAPE[1], 3))
    np.testing.assert_allclose(split.apply(drive), whole.apply(drive), rtol=1e-12)  # float64, up to 630 terms


# Codes.


@pytest.mark.parametrize("sources", [1, 4, 16, 25, 48, 300])
def test_an_s_matrix_separates_its_sources(sources: int) -> None:
    n = code_length(sources)
    assert n >= sources
    np.testing.assert_allclose(s_inverse(n) @ s_matrix(n), np.eye(n), atol=1e-13)  # float64 sums of n terms
    assert set(s_matrix(n).sum(axis=1)) == {(n + 1) // 2}


def test_stripes_find_every_pixel() -> None:
    shown = stripes(PROJECTOR, 1)
    assert len(shown) == 5 + 5
    lit = [stripe.paint().ravel().astype(float) for stripe in shown]
    row, column = np.mgrid[: PROJECTOR[0], : PROJECTOR[1]] + 0.5
    np.testing.assert_array_equal(locate(shown, lit, PROJECTOR), np.stack([row.ravel(), column.ravel()], 1))


def test_the_error_of_t_is_that_of_dense_matrices(rng: np.random.Generator) -> None:
    near = sharp_wall(rng)
    truth, found = with_far_light(near, 0.3), run(room_of(with_far_light(near, 0.3)), HierarchicalScheme())
    for one in (found.measured.transport, near):
        # float64 sums of 1e5 terms
        np.testing.assert_allclose(relative_error(one, truth), error(one, truth), rtol=1e-9)


# Cameras.


def test_noise_is_measured(rng: np.random.Generator) -> None:
    signal = rng.uniform(0.2, 1, (200, 300, 3))
    dark, gain = 0.002, 1e-4

    def shot(light: np.ndarray) -> np.ndarray:
        return light + rng.normal(size=light.shape) * np.sqrt(dark**2 + gain * light)

    noise = measure_noise([shot(0 * signal), shot(0 * signal)], [shot(signal), shot(signal)])
    np.testing.assert_allclose(noise.dark, dark, rtol=0.02)  # error of a median over 60 000 samples: 0.5 %
    np.testing.assert_allclose(noise.gain, gain, rtol=0.05)


def test_a_bracket_reaches_where_one_exposure_saturates() -> None:
    transport = Transport.from_matrices(
        (sparse.csr_array(np.diag(np.geomspace(1e-3, 1, SHAPE[0]))[:, : SHAPE[1]]),) * 3
    )
    room = room_of(transport, 0.0, projector=(1, SHAPE[0]))
    camera = SimulatedCamera(room, CameraSettings(Sensor(0, 0, 8), (8.0, 1.0), Response("srgb")))
    shots = camera.capture(0, np.ones((1, SHAPE[0]), bool))
    assert [shot.dtype for shot in shots] == [np.uint8, np.uint8]
    light = camera.exposures.radiance(shots).reshape(-1, 3)[:, 0]
    truth = transport.composition()[:, 0]
    # Half a code value: 0.9 % of the light at sRGB code 128 and above; the longer exposure covers darker codes.
    bright = truth > 0.05
    np.testing.assert_allclose(light[bright], truth[bright], rtol=0.02)
    assert not camera.exposures.saturated(shots).any()
    assert camera.exposures.saturated(shots[:1] * 2).any()


def test_shots_of_a_capture_are_averaged_and_the_threshold_follows_their_noise(rng: np.random.Generator) -> None:
    truth = sharp_wall(rng)
    one, nine = (
        run(room_of(truth), HierarchicalScheme(), replace(NOISY, exposures=(1.0,) * shots)) for shots in (1, 9)
    )
    assert nine.exposures == 9 * nine.pictures
    for level in (0.0, 0.5):
        sigmas = [done.room.noise.sigma(np.full((1, 3), level)) for done in (one, nine)]
        # The ratio is a third. 1404 samples; in the dark, the median of their noise takes few code values.
        np.testing.assert_allclose(sigmas[1], sigmas[0] / 3, rtol=0.2)
    assert error(nine.measured.transport, truth) < 0.5 * error(one.measured.transport, truth)


class CountingDevice(SimulatedDevice):
    """Counts the frames that are skipped, and records the exposure times."""

    def __init__(self, room: SimulatedRoom, settings: CameraSettings) -> None:
        super().__init__(room, settings, MemoryScreen(room.projector))
        self.passed, self.exposed = 0, list[float]()

    def expose(self, time: float) -> None:
        super().expose(time)
        self.exposed.append(time)

    def frame(self) -> Shot:
        self.passed -= 1  # super() skips up to the frame that it returns
        return super().frame()

    def skip(self) -> None:
        super().skip()
        self.passed += 1


def test_shots_of_one_exposure_follow_each_other_without_a_wait(rng: np.random.Generator) -> None:
    settings = replace(NOISY, exposures=(1.0, 1.0, 1.0, 0.5, 0.5), lag=2)
    device = CountingDevice(room_of(sharp_wall(rng)), settings)
    camera = LiveCamera(MemoryScreen(PROJECTOR), device, Exposures(settings.exposures), lag=2)
    shots = camera.capture(0, np.full((*PROJECTOR, 3), 255, np.uint8))
    assert (len(shots), device.exposed, device.passed) == (5, [1.0, 0.5], 4)


# Schemes against the truth.


def test_without_noise_the_hierarchical_scheme_finds_t(rng: np.random.Generator) -> None:
    truth = sharp_wall(rng)
    done = run(room_of(truth), HierarchicalScheme(Threshold(absolute=2e-4)), QUIET)
    # Steps of 16 bits, 2e-5 of full scale, in entries of 0.1 and more; weak entries below τ are spread over 2x2.
    assert error(done.measured.transport, truth) < 2e-3
    np.testing.assert_allclose(done.measured.transport.composition(), truth.composition(), atol=1e-4)
    assert done.check.error < 1e-3


def test_light_kept_at_coarse_levels_does_not_leak_into_fine_ones(rng: np.random.Generator) -> None:
    """A third of the light is far light.

    It is below τ for each small block, but far above τ for all blocks of a pattern.
    """
    near = sharp_wall(rng)
    truth = with_far_light(near, 0.33)
    done = run(room_of(truth), HierarchicalScheme(Threshold(absolute=0.004)), QUIET)
    transport = done.measured.transport
    dark = channel(near.near, 0).toarray() == 0
    leaked = channel(transport.near, 0).toarray() * dark
    assert leaked.sum() < 0.02 * channel(transport.near, 0).sum()
    assert error(transport, truth) < 0.03
    assert done.check.error < 0.02  # far light below τ stays in blocks of 8 px


@pytest.mark.parametrize("far", [0.0, 0.25])
def test_each_scheme_with_noise(rng: np.random.Generator, far: float) -> None:
    truth = with_far_light(sharp_wall(rng), far)
    schemes = (HierarchicalScheme(), MultiplexedScheme(), PixelByPixelScheme(), FixedBlocksScheme(8), GrayCodeScheme())
    done = [run(room_of(truth), scheme) for scheme in schemes]
    errors = [error(each.measured.transport, truth) for each in done]
    pictures = [each.pictures for each in done]
    # Photon noise of an entry of 0.25 is 1.4 %; unresolved far light in blocks adds to it.
    assert errors[0] < (0.05 if not far else 0.1)
    assert errors[1] < 0.05
    assert errors[2] < (0.05 if not far else 0.4)  # the far light is below the noise
    assert min(errors[3:]) > max(errors[:2])
    frame = 2 * REPEATS + 2 * SHOTS + len(light_level(PROJECTOR).patterns) + 3  # captures before and after a scheme
    assert pictures[2:4] == [frame + SHAPE[1], frame + 12 + 64]
    assert pictures[1] < pictures[0]
    for each in done[:2]:
        assert each.check.error < 3 * each.check.noise + 0.01


def test_the_hierarchical_scheme_sees_a_mirror_and_the_check_tells_who_does_not(rng: np.random.Generator) -> None:
    truth = mirror(rng)
    whole = run(room_of(truth), HierarchicalScheme())
    window = run(room_of(truth), MultiplexedScheme())
    assert error(whole.measured.transport, truth) < 0.05
    assert error(window.measured.transport, truth) > 0.2
    assert whole.check.error < 0.03
    assert window.check.error > 0.1


def test_the_window_grows_with_the_blur(rng: np.random.Generator) -> None:
    sides = []
    for sigma in (0.4, 1.3):
        done = run(room_of(sharp_wall(rng, sigma)), MultiplexedScheme())
        sides += [int(re.search(r"tiles of (\d+)", note)[1]) for note in done.measured.notes if "tiles" in note]  # type: ignore[index]
    assert 4 <= sides[0] <= 5
    assert 6 <= sides[1] <= 8  # a window of ± 2.3 σ has 6 pixels

"""Wide blur in cells: pruning of rows, and every operation on T with S + B P in place of T."""

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import sparse

from counterlight import calibration
from counterlight.errors import InputError
from counterlight.tools.blurring import blurring
from counterlight.tools.blurring.blurring import Blurring, chosen_limit
from counterlight.tools.blurring.pruning import LEVELS, Pyramid, in_cells
from counterlight.tools.import_transport import main as import_transport
from counterlight.tools.inverse.direct import lit_most
from counterlight.tools.joining.projectors import join_transports
from counterlight.tools.shipped import parse_scene
from counterlight.tools.simulation import simulate as simulation
from counterlight.tools.simulation.effects.blooming import bloom
from counterlight.tools.simulation.scene import Scene, load_scene
from counterlight.tools.simulation.simulate import simulate
from counterlight.tools.solve.box import Box
from counterlight.tools.solve.registry import prepare
from counterlight.tools.transport.mask import directly_lit
from counterlight.tools.transport.mixing import mixed_channels
from counterlight.tools.transport.objective import DEFAULT_AIMS, objective_of
from counterlight.tools.transport.storage import read_transport
from counterlight.tools.transport.transport import CHANNELS, Transport, dense_rows, in_one
from counterlight.tools.transport.trust import cut_by_edges, seen
from tests.blurred_rooms import (
    CAMERA,
    PROJECTOR,
    calibrated,
    discs,
    far_light,
    in_blocks,
    rows_of,
    write_room,
    written_out,
)
from tests.programs import fail

RADIUS = 6.0
SUMS = 1e-6  # relative to the largest, float32 weights: sums of a few hundred terms


@pytest.fixture
def T(rng: np.random.Generator) -> Transport:  # noqa: N802 - as the field calls it
    return in_blocks(discs(rng, RADIUS))


def alike(found: NDArray[np.floating], wanted: NDArray[np.floating]) -> None:
    np.testing.assert_allclose(found, wanted, rtol=0, atol=SUMS * np.abs(wanted).max())


def test_a_cell_is_the_mean_of_its_block() -> None:
    raster, picture = (21, 35), np.random.default_rng(1).uniform(size=(21, 35, 3))
    pyramid = Pyramid(raster)
    means = pyramid.means(np.ones(pyramid.cells, bool)).apply(picture.reshape(-1, 3))
    wanted = [
        picture[y : y + side, x : x + side].mean(axis=(0, 1))
        for side in (1 << level for level in range(1, LEVELS + 1))
        for y in range(0, raster[0] // side * side, side)
        for x in range(0, raster[1] // side * side, side)
    ]
    alike(means, np.array(wanted))


def test_rows_keep_their_light_and_become_few_cells(rng: np.random.Generator) -> None:
    full = discs(rng, RADIUS)
    T = in_blocks(full)
    assert T.blurred is not None
    assert T.entries < rows_of(full).indices.size / 3
    alike(T.composition(), full.sum(axis=2).T)
    found = written_out(T)
    assert found.min() >= 0
    pictures, blocks = full.reshape(3, -1, *PROJECTOR), Pyramid(PROJECTOR)
    B, (starts, sizes) = T.blurred.scatter, (blocks.starts, blocks.sizes)
    for row, cell, weights in list(zip(B.rows, B.indices, B.weights, strict=True))[::17]:
        level = int(np.searchsorted(starts, cell, side="right"))
        y, x = (n << level for n in divmod(int(cell - starts[level - 1]), sizes[level - 1][1]))
        side = 1 << level
        alike(weights, pictures[:, row, y : y + side, x : x + side].sum(axis=(1, 2)))


def test_without_a_limit_t_is_what_it_was(rng: np.random.Generator) -> None:
    full = discs(rng, RADIUS)
    alike(written_out(in_blocks(full, 0.0)), full)


@pytest.mark.parametrize("limit", [0.03, 0.1, 0.2, 0.3, 0.5])
def test_no_other_blocks_err_less_for_as_many_numbers(limit: float) -> None:
    """The choice is compared with all seventeen ways to divide sixteen pixels into blocks."""
    values = np.random.default_rng(3).uniform(0, 1, (4, 4, 3)) ** 4
    values[0, 1], values[2:, :2] = 0, 0.3
    near, scatter = in_cells(dense_rows(values.reshape(1, 16, 3).transpose(2, 0, 1)), (4, 4), limit)
    rent = limit**2 * np.sum(values.sum(axis=(0, 1)) ** 2)
    found = written_out(Transport(near, blurred=Pyramid((4, 4)).light(scatter)))[:, 0].T.reshape(4, 4, 3)
    numbers = near.indices.size + scatter.indices.size

    def halved(block: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        return [block[2 * i : 2 * i + 2, 2 * j : 2 * j + 2] for i, j in product(range(2), repeat=2)]

    def one(block: NDArray[np.float64]) -> float:
        return rent + float(np.sum((block - block.mean(axis=(0, 1))) ** 2))

    each = [rent * float(np.count_nonzero(block.any(axis=2))) for block in halved(values)]
    ways = [one(values)] + [
        sum(one(block) if whole else apart for whole, block, apart in zip(chosen, halved(values), each, strict=True))
        for chosen in product([True, False], repeat=4)
    ]
    cost = rent * numbers + np.sum((found - values) ** 2)
    assert cost == pytest.approx(min(ways), rel=1e-5)  # float32 weights


def test_a_row_that_lies_here_and_there_takes_no_more_than_its_entries() -> None:
    """A row like those behind glass: sixteen equal pixels in the first and in the last corner of a large raster."""
    T = np.zeros((3, 1, 400, 600))
    T[..., :4, :4], T[..., -8:-4, -8:-4] = 1 / 32, 1 / 32
    near, scatter = in_cells(rows_of(T.reshape(3, 1, -1)), (400, 600), 0.01)
    assert near.indices.size == 0
    assert scatter.indices.size == 2


def test_blocks_that_the_rasters_edge_cuts_are_no_cells(rng: np.random.Generator) -> None:
    T = np.full((3, 1, 5, 6), 1 / 30)
    near, scatter = in_cells(rows_of(T.reshape(3, 1, -1)), (5, 6), 0.5)
    assert near.indices.size == 6  # the last row, which has no second half
    assert scatter.indices.size == 1 + 2


def test_its_transpose_is_its_transpose(T: Transport, rng: np.random.Generator) -> None:
    u, v = rng.normal(size=(T.shape[1], 3)), rng.normal(size=(T.shape[0], 3))
    dense = written_out(T)
    alike(T.apply(u), np.einsum("cij,jc->ic", dense, u))
    alike(T.apply_transpose(v), np.einsum("cij,ic->jc", dense, v))
    alike(T.T.apply(v), T.apply_transpose(v))
    alike(written_out(Transport(in_one(T))), dense)


def test_trust_and_what_is_seen_are_those_of_its_entries(T: Transport) -> None:
    alone = Transport(in_one(T), camera=CAMERA, projector=PROJECTOR)
    every = np.ones(T.shape[0], bool)
    alike(cut_by_edges(T, CAMERA, PROJECTOR), cut_by_edges(alone, CAMERA, PROJECTOR))
    alike(seen(T, every), seen(alone, every))
    np.testing.assert_array_equal(T.lit, alone.lit)
    dark = np.zeros((*CAMERA, 3))
    np.testing.assert_array_equal(directly_lit(T, dark, PROJECTOR), directly_lit(alone, dark, PROJECTOR))


def test_who_looks_at_t_leaves_it_as_it_is(T: Transport) -> None:
    narrow = replace(T.near, indptr=T.near.indptr.astype(np.int32))  # scipy would use these indices without a copy
    T = replace(T, near=narrow)
    before = narrow.indptr.copy(), narrow.indices.copy(), narrow.weights.copy()
    cut_by_edges(T, CAMERA, PROJECTOR)
    seen(T, np.ones(T.shape[0], bool))
    for array, was in zip((narrow.indptr, narrow.indices, narrow.weights), before, strict=True):
        np.testing.assert_array_equal(array, was)


def test_what_is_minimised_is_that_of_its_entries(T: Transport) -> None:
    room = calibrated(T)
    by_cells, by_entries = (
        objective_of(each, room, DEFAULT_AIMS) for each in (T, replace(T, near=in_one(T), blurred=None))
    )
    assert by_cells.prior is not None
    assert by_entries.prior is not None
    for name in ("damping", "right", "down"):
        alike(getattr(by_cells.prior, name), getattr(by_entries.prior, name))
    alike(by_cells.curvature, by_entries.curvature)
    b = by_cells.bounded(0.3 * np.ones((T.shape[0], 3)))
    alike(*(each.descent(np.full((T.shape[1], 3), 0.2), b) for each in (by_cells, by_entries)))


def test_direct_mapping_asks_the_camera_pixel_that_is_lit_most(T: Transport) -> None:
    weights = np.array([0.2126, 0.7152, 0.0722])
    dense = np.einsum("cij,c->ij", written_out(T), weights)
    chosen = lit_most(T.T)
    columns = np.arange(T.shape[1])
    np.testing.assert_allclose(dense[chosen, columns], dense.max(axis=0), rtol=1e-5)  # BT.709 of float32 sums
    unlit = replace(T, near=T.near.inside(np.zeros(T.shape[0], bool)), blurred=None)
    assert (lit_most(unlit.T) == -1).all()


def test_channels_mix_as_those_of_its_entries(T: Transport) -> None:
    mixing = np.array([[0.9, 0.1, 0.0], [0.05, 0.9, 0.05], [0.0, 0.2, 0.8]])
    mixed = written_out(mixed_channels(T, mixing))
    alike(mixed, np.einsum("kc,cij->kij", mixing, written_out(T)))


def test_projectors_beside_each_other(rng: np.random.Generator) -> None:
    left = in_blocks(discs(rng, RADIUS))
    right = Transport(rows_of(discs(rng, 1.0, projector=(20, 30))), camera=CAMERA, projector=(20, 30))
    joint = join_transports([left, right], [PROJECTOR, (20, 30)])
    drives = rng.uniform(size=(*PROJECTOR, 3)), rng.uniform(size=(20, 30, 3))
    raster = np.zeros((PROJECTOR[0], PROJECTOR[1] + 30, 3))
    raster[:, : PROJECTOR[1]], raster[:20, PROJECTOR[1] :] = drives
    alike(
        joint.apply(raster.reshape(-1, 3)),
        sum(each @ p for each, p in zip((left, right), drives, strict=True)).reshape(-1, 3),
    )


def test_files_hold_it_to_the_last_bit(T: Transport, tmp_path: Path) -> None:
    far = far_light(T.shape)
    write_room(tmp_path / "room", replace(T, far=far))
    found = read_transport(calibration.read(tmp_path / "room"))
    assert found.blurred is not None
    assert T.blurred is not None
    for one, other in ((found.near, T.near), (found.blurred.scatter, T.blurred.scatter)):
        np.testing.assert_array_equal(one.indices, other.indices)
        np.testing.assert_array_equal(one.weights, other.weights)
    alike(written_out(found), written_out(replace(T, far=far)))


def test_solvers_take_it_as_they_take_its_entries(T: Transport) -> None:
    b = np.random.default_rng(5).uniform(0, 0.5, (T.shape[0], 3))
    alone = Transport(in_one(T))
    direct = [prepare("direct", each).solve(b).drive for each in (T, alone)]
    alike(*direct)
    gaps = [Box(each).run(b)[0] for each in (T, alone)]
    errors = [np.sum((alone.apply(p) - b) ** 2) for p in gaps]
    assert errors[0] == pytest.approx(errors[1], rel=2e-4)  # each is solved to a relative gap of 1e-4


def test_pictures_lose_no_more_than_the_tolerance(rng: np.random.Generator) -> None:
    """The loss is measured by the box optima of the whole picture, which the choice did not use."""
    full = discs(rng, RADIUS, tinted=False)
    rows, tolerance = rows_of(full), 0.2
    choice = chosen_limit([rows], CAMERA[1], PROJECTOR, tolerance)
    assert choice.limit > 0
    assert max(choice.losses.values()) <= tolerance
    T, made = Transport(rows), in_blocks(full, choice.limit)
    assert made.entries < rows.indices.size / 2
    white = np.percentile(T.composition(), 10)
    b = white * np.repeat(np.random.default_rng(7).choice([0.1, 0.9], (T.shape[0], 1)), 3, axis=1)
    errors = [np.sum((T.apply(Box(each).run(b)[0]) - b) ** 2) for each in (made, T)]
    # This picture is noise, unlike the two that decide. Blur removes most noise, so the loss is smaller.
    assert 10 * np.log10(errors[0] / errors[1]) < tolerance


def test_sharp_rows_are_left_to_a_limit_that_changes_nothing(rng: np.random.Generator) -> None:
    sharp = rows_of(discs(rng, 0.7))
    choice = chosen_limit([sharp], CAMERA[1], PROJECTOR, 1e-9)
    near, scatter = in_cells(sharp, PROJECTOR, choice.limit)
    assert near.indices.size + scatter.indices.size > 0.9 * sharp.indices.size


def test_what_cannot_be_cut_says_so(T: Transport, tmp_path: Path) -> None:
    from counterlight.tools.study.rooms import open_room

    write_room(tmp_path / "room", T)
    with pytest.raises(InputError, match=r"room: its blurred light is kept in blocks of pixels"):
        open_room(tmp_path / "room", (10, 10))


@pytest.fixture
def wide() -> Scene:
    """Two planes through a lens six times as wide: discs with a radius of up to five pixels."""
    scene = load_scene(parse_scene("two_planes")).resized((54, 96), (54, 96))
    return replace(scene, projector=replace(scene.projector, aperture=6 * scene.projector.aperture))


def test_the_simulator_puts_long_rows_in_cells(wide: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    # bands of ten rows: some before the choice, some after it
    monkeypatch.setattr(simulation, "BAND_RAYS", 96 * 16 * 10)
    full = simulate(wide)
    assert full.transport.blurred is None  # few enough entries to play as they are
    assert full.blurring is None
    monkeypatch.setattr(blurring, "MANY", 1000)
    monkeypatch.setattr(blurring, "LONG", 2)
    made = simulate(wide, tolerance=0.2)
    assert made.transport.blurred is not None
    assert made.blurring is not None
    assert max(made.blurring.losses.values()) <= 0.2
    assert made.transport.entries < full.transport.near.indices.size / 2
    assert "blurred light in blocks of pixels" in str(made.blurring)
    alike(made.transport.composition(), full.transport.composition())
    as_it_is = simulate(wide, tolerance=0)
    assert as_it_is.transport.blurred is None
    alike(as_it_is.transport.near.weights, full.transport.near.weights)


GAUSSIAN_CAMERA, GAUSSIAN_PROJECTOR = (24, 29), (22, 26)


def gaussian_room(rng: np.random.Generator) -> NDArray[np.float64]:
    """T of one channel, (camera pixels, projector pixels): painted Gaussians that widen to the right, with noise.

    σ is 2 to 4 projector pixels, cut at 3 σ. The noise is a hundredth of each entry.
    """
    (H, W), (h, w) = GAUSSIAN_CAMERA, GAUSSIAN_PROJECTOR
    y, x = np.mgrid[:H, :W].reshape(2, -1, 1)
    v, u = np.mgrid[:h, :w].reshape(2, 1, -1)
    away = ((y + 0.5) * h / H - v - 0.5) ** 2 + ((x + 0.5) * w / W - u - 0.5) ** 2
    sigma = 2 + 2 * x / W
    T = np.where(away < 9 * sigma**2, np.exp(-away / (2 * sigma**2)) / (2 * np.pi * sigma**2), 0)
    return np.asarray(T * rng.uniform(0.4, 1, (H * W, 1)) * rng.normal(1, 0.01, T.shape))


def best_error(T: NDArray[np.float64], by: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """Returns Σ (T p − b)², where p in 0..1 is the best drive by `by` instead of T (accelerated projected gradient)."""
    curvature = np.linalg.norm(by, 1) * np.linalg.norm(by, np.inf)
    p = before = np.full(by.shape[1], 0.5)
    for step in range(300):
        ahead = p + step / (step + 3) * (p - before)
        before, p = p, np.clip(ahead - by.T @ (by @ ahead - b) / curvature, 0, 1)
    return float(np.sum((T @ p - b) ** 2))


def test_an_imported_blur_is_put_into_blocks_that_keep_the_tolerance(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], rng: np.random.Generator
) -> None:
    """T, pictures and solver are independent of the product."""
    monkeypatch.setattr(blurring, "MANY", 1000)
    tolerance, full = 0.1, gaussian_room(rng).astype(np.float32).astype(np.float64)
    sparse.save_npz(tmp_path / "T.npz", sparse.csr_array(full.astype(np.float32)))
    (H, W), (h, w) = GAUSSIAN_CAMERA, GAUSSIAN_PROJECTOR
    words = [word for name in CHANNELS for word in (f"--{name}", str(tmp_path / "T.npz"))]
    sizes = ["--camera", f"{W}x{H}", "--projector", f"{w}x{h}", "--tolerance", str(tolerance)]
    assert import_transport([*words, *sizes, "-o", str(tmp_path / "room")]) == 0
    said = capsys.readouterr().out
    made = read_transport(calibration.read(tmp_path / "room"))
    assert made.blurred is not None
    assert f"{np.count_nonzero(full)} entries a channel are {made.near.indices.size} near and" in said
    assert made.entries < np.count_nonzero(full) / 2
    found = written_out(made)[1]
    np.testing.assert_allclose(found.sum(axis=1), full.sum(axis=1), rtol=1e-5)  # float32 sums of up to 450
    white = np.percentile(full.sum(axis=1), 10)
    y, x = np.mgrid[:H, :W]
    waves = 0.5 + 0.2 * np.sin(x / 3) + 0.2 * np.cos(y / 4)
    for picture in (waves, (x + y) % 16 < 8, np.hypot(x - 15, y - 11) < 6):
        b = white * np.clip(picture, 0.05, 0.95).ravel()
        floor = 1e-6 * white**2 * b.size  # 60 dB below white counts as no error
        lost = 10 * np.log10((best_error(full, found, b) + floor) / (best_error(full, full, b) + floor))
        assert lost < tolerance


def test_what_is_not_worth_blocks_stays(T: Transport, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    short = Transport(rows_of(discs(rng, RADIUS)), camera=CAMERA, projector=PROJECTOR)
    assert blurring.in_blocks(short, 0.1) == (short, None)  # maps can hold T as it is
    monkeypatch.setattr(blurring, "MANY", 1000)
    monkeypatch.setattr(blurring, "LONG", 1)
    assert blurring.in_blocks(short, 0.0) == (short, None)
    assert blurring.in_blocks(T, 0.1) == (T, None)  # T is already in blocks
    sharp = Transport(rows_of(discs(rng, 0.7)), camera=CAMERA, projector=PROJECTOR)
    assert blurring.in_blocks(sharp, 1e-9) == (sharp, None)
    monkeypatch.setattr(blurring, "BAND", 5000)
    made, done = blurring.in_blocks(short, 0.2)
    assert done is not None
    assert max(done.losses.values()) <= 0.2
    alike(made.composition(), short.composition())
    alike(written_out(made), written_out(in_blocks_at_once(short, done)))


def in_blocks_at_once(short: Transport, done: Blurring) -> Transport:
    """Compress all rows of T at once, with the limit whose losses were reported."""
    choice = chosen_limit([short.near], CAMERA[1], PROJECTOR, 0.2)
    assert choice.losses == done.losses
    near, scatter = in_cells(short.near, PROJECTOR, choice.limit)
    return replace(short, near=near, blurred=Pyramid(PROJECTOR).light(scatter))


def test_halos_are_those_of_its_entries(T: Transport, wide: Scene) -> None:
    camera = replace(wide.camera, height=CAMERA[0], width=CAMERA[1], bloom_share=0.05, bloom_radius=0.02)
    dark = np.zeros((T.shape[0], 3))
    found, wanted = (
        bloom(replace(wide, camera=camera), each, dark)[0] for each in (T, replace(T, near=in_one(T), blurred=None))
    )
    p = np.random.default_rng(3).uniform(size=(T.shape[1], 3))
    alike(found.apply(p), wanted.apply(p))


def test_a_tolerance_out_of_range_is_refused() -> None:
    said = fail("simulate", "two_planes", "--explain", "--tolerance", "11")
    assert "--tolerance 11: expected 0 (T stays as it is) to 10 dB" in said

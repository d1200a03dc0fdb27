"""Factors a dense T into near light and factors: closed forms, losses at the box optimum, and T that stays as it is."""

from dataclasses import replace
from pathlib import Path

import numba
import numpy as np
import pytest
from scipy import sparse

import counterlight as cl
from counterlight import calibration, memory
from counterlight.errors import InputError
from counterlight.files import exr
from counterlight.pipeline.content import camera_psnr, reachable_white
from counterlight.tools import import_transport
from counterlight.tools.choices import MOST_TOLERANCE, TOLERANCE
from counterlight.tools.factoring import factoring, passes
from counterlight.tools.factoring.factoring import LIMITS, Factoring, factored
from counterlight.tools.factoring.losses import asked, compensated, measured
from counterlight.tools.factoring.model import Grid, Model, Rows, fitted, split
from counterlight.tools.inverse.pictures import soft_picture, typical_pictures
from counterlight.tools.solve.registry import prepare
from counterlight.tools.transport.mask import directly_lit
from counterlight.tools.transport.storage import read_transport
from counterlight.tools.transport.transport import CHANNELS, Transport, channel, channels, far_light_of, stacked
from tests.acquired_rooms import dense
from tests.dense_rooms import CAMERA, PROJECTOR, SHAPE, direct, radiosity_corner, textured_glow, transport
from tests.programs import here, refusal_here, succeed
from tests.rooms import blurred_transport

DARK = np.zeros((*CAMERA, 3))
FLOAT32 = 3e-6  # relative to T·1: float32 entries, a few hundred per row


@pytest.fixture(scope="module")
def corner() -> Transport:
    return radiosity_corner()


@pytest.fixture(scope="module")
def factored_corner(corner: Transport) -> tuple[Transport, Factoring]:
    numba.set_num_threads(numba.config.NUMBA_NUM_THREADS)
    return factored(corner, in_the_dark(corner))


def projector_of(T: Transport) -> tuple[int, int]:
    assert T.projector is not None
    return T.projector


def in_the_dark(T: Transport) -> np.ndarray:
    assert T.camera is not None
    return np.zeros((*T.camera, 3))


def test_nodes_share_a_pixel_and_keep_what_is_linear() -> None:
    grid = Grid.over((12, 20), 15)
    assert grid.nodes == (3, 5)
    Phi = grid.textured(np.ones(240)).toarray()
    np.testing.assert_allclose(Phi.sum(axis=1), 1, rtol=1e-15)
    rows, columns = (((np.arange(n) + 0.5) * 4).reshape(shape) for n, shape in ((3, (3, 1)), (5, (1, 5))))
    y, x = ((np.arange(n) + 0.5) for n in (12, 20))
    found = (Phi @ (2 * rows - 3 * columns).ravel()).reshape(12, 20)
    inside = np.ix_((y > 2) & (y < 10), (x > 2) & (x < 18))  # constant beyond the outer nodes
    np.testing.assert_allclose(found[inside], (2 * y[:, None] - 3 * x)[inside], rtol=0, atol=1e-12)


@pytest.mark.parametrize("picture", [(1, 1), (1, 40), (40, 1), (2, 3)])
def test_grids_of_pictures_that_are_hardly_any(picture: tuple[int, int]) -> None:
    grid = Grid.over(picture, 48)
    assert 1 <= grid.count <= max(1, picture[0] * picture[1] // 2)
    assert grid.corners.max() < grid.count
    np.testing.assert_allclose(grid.weights.sum(axis=1), 1, rtol=1e-15)


def test_light_between_textured_surfaces_is_found_and_sharp_light_stays_near(rng: np.random.Generator) -> None:
    sharp, glow = direct(rng), textured_glow(rng)
    T = transport([sharp + tint * glow for tint in (1.0, 0.5, 0.8)])
    found, done = factored(T, DARK)
    assert done.losses, done.reason
    assert done.near == SHAPE[0]  # one entry per camera pixel
    assert done.before == SHAPE[0] * SHAPE[1]
    np.testing.assert_allclose(found.composition(), T.composition(), rtol=FLOAT32)
    expected, seen = dense(T), dense(found)
    # The model replaces the hidden light below the four entries around each sharp entry, of 432; it is estimated 3
    # times.
    assert np.linalg.norm(seen - expected) <= 0.02 * np.linalg.norm(glow)


def test_pictures_lose_by_the_box_optimum_what_was_said(
    corner: Transport, factored_corner: tuple[Transport, Factoring]
) -> None:
    found, done = factored_corner
    assert done.losses, done.reason
    assert 10 * done.after <= done.before
    ambient, mask = in_the_dark(corner), directly_lit(corner, in_the_dark(corner), projector_of(corner))
    white = reachable_white(corner.floodlight(ambient), mask)
    photograph = white * np.repeat(typical_pictures(mask.shape)[0][..., None], 3, axis=2)
    half = white * np.where(np.arange(mask.shape[1]) < mask.shape[1] // 2, 0.0, 1.0)[None, :, None] + 0 * photograph
    soft = white * np.repeat(soft_picture(mask.shape)[..., None], 3, axis=2)
    for name, desired in (("photograph", photograph), ("half", half), ("soft", soft)):
        by_T, by_factors = (
            camera_psnr(
                desired, corner.apply(prepare("box", T, mask).solve(desired).drive).reshape(desired.shape), mask, white
            )
            for T in (corner, found)
        )
        # The solver's gap of 1e-4 is 0.001 dB; the reported loss is measured after a fixed number of steps.
        assert by_T - by_factors <= done.losses[name] + 0.01
        assert by_T - by_factors <= 0.11


def test_a_mask_by_near_light_leaves_out_what_far_light_alone_reaches(rng: np.random.Generator) -> None:
    sharp = direct(rng)
    unlit = np.arange(SHAPE[0]) % CAMERA[1] < 8  # the left quarter of the view lies outside the projector's beam
    sharp[unlit] = 0
    T = transport([sharp + textured_glow(rng, 0.5)] * 3)
    assert directly_lit(T, DARK, projector_of(T)).ravel()[unlit].any()
    found, done = factored(T, DARK)
    assert done.losses, done.reason
    alone = transport([sharp] * 3)
    np.testing.assert_array_equal(*(directly_lit(each, DARK, projector_of(each)) for each in (found, alone)))


@pytest.mark.parametrize(("sigma", "tolerance"), [(0.6, ()), (1.0, ()), (1.5, ()), (3.0, (1.0,))])
def test_light_up_to_a_quarter_of_the_raster_wide_stays_near(
    rng: np.random.Generator, sigma: float, tolerance: tuple[float, ...]
) -> None:
    T = transport([blurred_transport(rng, CAMERA, PROJECTOR, sigma).toarray()] * 3)
    found, done = factored(T, DARK, *tolerance)
    assert found is T
    assert done.reason


def test_wide_light_below_far_light_stays_as_it_is(rng: np.random.Generator) -> None:
    blur = blurred_transport(rng, CAMERA, PROJECTOR, 0.6).toarray()
    found, done = factored(transport([blur + textured_glow(rng)] * 3), DARK)
    assert done.losses, done.reason
    near = channel(found.near, 0).toarray()
    # Little of the blur's rim is dropped: entries below a sixteenth of a row's far light.
    assert np.linalg.norm(near - blur) <= 0.1 * np.linalg.norm(blur)


def test_a_sparse_room_is_left_alone(rng: np.random.Generator) -> None:
    T = transport([direct(rng)] * 3)
    found, done = factored(T, DARK)
    assert found is T
    assert str(done) == f"T is left as it is, {SHAPE[0]} numbers a channel: it is sparse"


def test_light_without_structure_is_left_alone(rng: np.random.Generator) -> None:
    T = transport([direct(rng) + 4 * (rng.random(SHAPE) < 0.2) * rng.random(SHAPE) / SHAPE[1] * 5 for _ in CHANNELS])
    found, done = factored(T, DARK)
    assert found is T
    assert done.reason


def test_noise_of_a_measurement_becomes_no_texture(rng: np.random.Generator) -> None:
    sharp, glow = direct(rng), textured_glow(rng)
    noisy = glow * (1 + 0.3 * rng.standard_normal(SHAPE))
    T = transport([sharp + np.maximum(noisy, 0)] * 3)
    found, done = factored(T, DARK)
    assert done.losses, done.reason
    far = sharp == 0
    away, nearer = (np.linalg.norm((dense(each)[0] - glow)[far]) for each in (T, found))
    # A texture is a mean over hundreds of entries: 0.3 / √432 and 0.3 / √768 of it are 0.018 of the original 0.3.
    assert nearer < 0.2 * away


def test_far_light_that_is_known_already_is_factored_anew(rng: np.random.Generator) -> None:
    """Acquired far light has a hundred cells, each seen by every camera pixel, and faint entries."""
    cells = 108
    labels = np.arange(SHAPE[1]) * cells // SHAPE[1]
    D = sparse.csr_array((np.full(SHAPE[1], 4 / SHAPE[1]), (labels, np.arange(SHAPE[1]))), shape=(cells, SHAPE[1]))
    U = sparse.csr_array(np.outer(rng.uniform(0.5, 1.5, SHAPE[0]), np.linspace(0.5, 1.5, cells)) * 0.1)
    far = far_light_of([D] * 3, np.stack([np.eye(cells)] * 3), [U] * 3)
    near = stacked([sparse.csr_array(direct(rng), dtype=np.float32)] * 3)
    T = Transport(near, far, CAMERA, PROJECTOR)
    found, done = factored(T, DARK)
    assert done.losses, done.reason
    assert found.far is not None
    assert found.far.scatter.indices.size <= 4 * SHAPE[0]
    np.testing.assert_allclose(found.composition(), T.composition(), rtol=FLOAT32)
    assert np.linalg.norm(dense(found) - dense(T)) <= 0.01 * np.linalg.norm(dense(T))


def test_the_same_whatever_the_number_of_cores(corner: Transport, factored_corner: tuple[Transport, Factoring]) -> None:
    numba.set_num_threads(1)
    first, summary = factored(corner, in_the_dark(corner))
    numba.set_num_threads(numba.config.NUMBA_NUM_THREADS)
    second, again = factored_corner
    assert summary == again
    assert first.far is not None
    assert second.far is not None
    for one, other in (
        (first.near, second.near),
        (first.far.gather, second.far.gather),
        (first.far.scatter, second.far.scatter),
    ):
        np.testing.assert_array_equal(one.indices, other.indices)
        np.testing.assert_array_equal(one.weights, other.weights)
    np.testing.assert_array_equal(first.far.mix.matrices, second.far.mix.matrices)


def emptied_rows(T: list[np.ndarray]) -> None:
    for each in T:
        each[5:200] = 0


def emptied_columns(T: list[np.ndarray]) -> None:
    for each in T:
        each[:, ::3] = 0


def emptied_channel(T: list[np.ndarray]) -> None:
    T[1][:] = 0


def one_bright_entry(T: list[np.ndarray]) -> None:
    T[0][3, 4] = 1e9


def faint(T: list[np.ndarray]) -> None:
    for each in T:
        each *= 1e-20


@pytest.mark.parametrize("damage", [emptied_rows, emptied_columns, emptied_channel, one_bright_entry, faint])
def test_odd_rooms_keep_their_floodlight(rng: np.random.Generator, damage) -> None:  # type: ignore[no-untyped-def]
    given = [direct(rng) + textured_glow(rng) for _ in CHANNELS]
    damage(given)
    T = transport(given)
    found, _ = factored(T, DARK)
    np.testing.assert_allclose(found.composition(), T.composition(), rtol=FLOAT32, atol=0)
    assert (found.near.weights >= 0).all()


@pytest.mark.parametrize(
    ("camera", "projector"),
    [((1, 1), (1, 1)), ((24, 32), (1, 1)), ((1, 700), (1, 300)), ((40, 1), (1, 40)), ((1, 1), (20, 30))],
)
def test_rooms_of_few_pixels(rng: np.random.Generator, camera: tuple[int, int], projector: tuple[int, int]) -> None:
    shape = camera[0] * camera[1], projector[0] * projector[1]
    f, g = rng.uniform(0.5, 1.5, shape[0]), rng.uniform(0.5, 1.5, shape[1])
    T = transport([np.outer(f, g)] * 3, camera, projector)
    found, _ = factored(T, np.zeros((*camera, 3)))
    np.testing.assert_allclose(found.composition(), T.composition(), rtol=FLOAT32)


def test_darkness_is_left_alone() -> None:
    T = transport([np.zeros(SHAPE)] * 3)
    assert factored(T, DARK)[0] is T


def test_zero_tolerance_keeps_all(corner: Transport) -> None:
    found, done = factored(corner, in_the_dark(corner), 0)
    assert found is corner
    assert done.reason == "--tolerance 0"


@pytest.mark.parametrize("tolerance", [-0.1, np.nan, np.inf, 2 * MOST_TOLERANCE])
def test_tolerances_that_are_none(corner: Transport, tolerance: float) -> None:
    with pytest.raises(InputError, match=r"expected 0 .* to 10 dB"):
        factored(corner, in_the_dark(corner), tolerance)


def test_too_little_memory_is_said_before_work(corner: Transport, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "available_bytes", lambda: 1 << 20)
    with pytest.raises(InputError, match=r"factoring a dense T needs about .* keep T as it is with --tolerance 0"):
        factored(corner, in_the_dark(corner))


def test_more_pixels_than_nodes_can_serve_are_left_alone(corner: Transport, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(factoring, "MOST_NODES", 0)
    found, done = factored(corner, in_the_dark(corner))
    assert found is corner
    assert "too many nodes" in done.reason


def test_a_stricter_tolerance_is_kept(corner: Transport, factored_corner: tuple[Transport, Factoring]) -> None:
    _, strict = factored(corner, in_the_dark(corner), 0.01)
    assert max(strict.losses.values()) <= 0.01
    assert factored_corner[1].after <= strict.after


def test_what_one_pass_says_of_all_limits_is_what_each_split_misses(
    rng: np.random.Generator, corner: Transport
) -> None:
    rows = Rows.of(corner)
    model = fitted(rows, (48, 24), 64.0)
    drive = rng.uniform(size=(corner.shape[1], 3, 2))
    ones = np.concatenate([np.ones((corner.shape[1], 3, 1)), drive], axis=2)
    beside = np.zeros((corner.shape[0], 3, 3))
    for limit in (16.0, 64.0, 256.0):
        made = split(rows, replace(model, limit=limit))
        # the other rows keep all entries, because the model does not reach their light
        met = made.near.lengths < rows.near.lengths
        assert met.mean() > 0.5
        kept, squares = passes.missed(
            *passes.operands(rows.near), True, LIMITS, *model.textures, *model.grids, ones, beside, met
        )
        kept, squares = kept.sum(axis=0), squares.sum(axis=0)
        at = int(np.flatnonzero(limit == LIMITS)[0])
        if met.all():
            assert kept[at] == made.near.indices.size
        for u in range(2):
            wrong = corner.apply(drive[..., u]) - made.apply(drive[..., u])
            # float32 entries on one side
            np.testing.assert_allclose(squares[at, :, u + 1], np.sum(wrong[met] ** 2, axis=0), rtol=1e-3)


def test_residuals_and_what_they_send_back(rng: np.random.Generator, corner: Transport) -> None:
    drive, offset = rng.uniform(size=(corner.shape[1], 3, 2)), rng.normal(size=(corner.shape[0], 3, 2))
    counted = rng.random(corner.shape[0]) < 0.7
    residual, parts = passes.residual_and_back(*passes.operands(corner.near), drive, offset, counted)
    back = parts.sum(axis=0)
    for u in range(2):
        expected = np.where(counted[:, None], corner.apply(drive[..., u]) + offset[..., u], 0)
        np.testing.assert_allclose(residual[..., u], expected, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(back[..., u], corner.apply_transpose(expected), rtol=1e-9, atol=1e-9)


def test_what_is_not_factored_loses_nothing() -> None:
    corner = radiosity_corner(0.12)
    pictures = compensated(corner, asked(corner, directly_lit(corner, in_the_dark(corner), projector_of(corner))))
    assert max(measured(corner, corner, pictures).values()) == 0


def test_the_far_light_of_a_model_is_its_formula(rng: np.random.Generator) -> None:
    grids = Grid.over(CAMERA, 12), Grid.over(PROJECTOR, 6)
    F, G = rng.uniform(size=(SHAPE[0], 3)), rng.uniform(size=(SHAPE[1], 3))
    M = rng.normal(size=(grids[0].count, grids[1].count, 3))
    far = Model(*grids, F, G, M, 1.0).far_light()
    p = rng.uniform(size=(SHAPE[1], 3))
    for i in range(3):
        Phi, Psi = (grid.textured(np.ones(len(grid.corners))) for grid in grids)
        expected = F[:, i] * (Phi @ (M[..., i] @ (Psi.T @ (G[:, i] * p[:, i]))))
        np.testing.assert_allclose(far.apply(p)[:, i], expected, rtol=1e-9, atol=1e-12)


def write_matrices(folder: Path, T: Transport) -> list[str]:
    """Write matrices as another program would; returns the options that name them."""
    for name, matrix in zip(CHANNELS, channels(T.near), strict=True):
        sparse.save_npz(folder / f"{name}.npz", matrix)
    assert T.camera is not None
    assert T.projector is not None
    sizes = [f"{width}x{height}" for height, width in (T.camera, T.projector)]
    files = [word for name in CHANNELS for word in (f"--{name}", str(folder / f"{name}.npz"))]
    return [*files, "--camera", sizes[0], "--projector", sizes[1]]


def test_an_imported_corner_is_factored_built_and_played(tmp_path: Path, corner: Transport) -> None:
    given = write_matrices(tmp_path, corner)
    said = succeed("import-transport", *given, "-o", tmp_path / "factored")
    assert "dense T factored: " in said
    assert "pictures lose, in dB: photograph 0.0" in said
    kept = here("import-transport", *given, "-o", tmp_path / "dense", "--tolerance", "0")
    assert "T is left as it is" in kept
    rooms = {name: calibration.read(tmp_path / name) for name in ("factored", "dense")}
    transports = {name: read_transport(room) for name, room in rooms.items()}
    assert transports["dense"].far is None
    assert transports["factored"].far is not None
    mask = rooms["factored"].calibration.mask
    assert mask.any()
    # the rim of the lit area, whose footprints are hidden by far light
    assert (mask & ~rooms["dense"].calibration.mask).mean() < 0.01
    picture = tmp_path / "picture.exr"
    white = reachable_white(corner.floodlight(in_the_dark(corner)), mask)
    desired = 0.6 * white * np.repeat(typical_pictures(mask.shape)[0][..., None], 3, axis=2) + 0.1 * white
    exr.write_rgb(picture, desired.astype(np.float32))
    seen = {}
    for name in rooms:
        here("build", tmp_path / name)
        drive, view = tmp_path / f"{name}.exr", tmp_path / f"{name}_view.exr"
        here("play", tmp_path / name, picture, "--no-config", "--refine", "64", "--output", drive)
        here("play", tmp_path / name, picture, "--no-config", "--refine", "64", "--output", view, "--view", "camera")
        p = exr.read_rgb(drive).astype(np.float64)
        seen[name] = corner.apply(p).reshape(desired.shape)
        # The player's prediction from the factors equals T times the drive, up to the dropped light.
        assert camera_psnr(seen[name], exr.read_rgb(view), mask, white) > 40
    by_dense, by_factors = (camera_psnr(desired, seen[name], mask, white) for name in ("dense", "factored"))
    assert by_factors >= by_dense - 0.1


@pytest.mark.parametrize("tolerance", ["-1", "nan", "11", "much"])
def test_a_tolerance_that_is_none_writes_nothing(
    tmp_path: Path, rng: np.random.Generator, capsys: pytest.CaptureFixture[str], tolerance: str
) -> None:
    words = *write_matrices(tmp_path, transport([direct(rng)] * 3)), "-o", tmp_path / "room"
    line = refusal_here(import_transport.main, capsys, tmp_path, *words, f"--tolerance={tolerance}")
    assert f"--tolerance {tolerance}: expected 0 (T stays as it is) to 10 dB" in line


def test_python_factors_too(corner: Transport) -> None:
    assert corner.camera is not None
    assert corner.projector is not None
    matrices, sizes = (
        channels(corner.near),
        {"camera": corner.camera, "projector": corner.projector},
    )
    room, whole = (
        cl.Room.from_matrices(*matrices, **sizes, response="linear", factor=factor) for factor in (TOLERANCE, 0)
    )
    assert room.parts.far is not None
    assert whole.parts.far is None
    np.testing.assert_allclose(room.floodlight, whole.floodlight, rtol=FLOAT32)

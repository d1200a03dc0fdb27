"""The CPU solvers against scipy's and closed forms, the figures that judge them, and the command.

`make fuzz` draws more random systems.
"""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse
from scipy.optimize import lsq_linear, nnls
from skimage.color import deltaE_ciede2000, rgb2lab

from counterlight import calibration
from counterlight.arrays import FloatArray
from counterlight.calibration import Calibration, Device, StoredCalibration
from counterlight.files import exr
from counterlight.processing import LEVELS, Processing
from counterlight.response import Response
from counterlight.tools import build_correction_map
from counterlight.tools.clusters.components import NonFiniteError
from counterlight.tools.colour.tiers import tier_of
from counterlight.tools.solve.box import MOST_STEPS, TOLERANCE
from counterlight.tools.solve.channel import Channel
from counterlight.tools.solve.clusterwise import Blockwise, Clusterwise, LeastSquares
from counterlight.tools.solve.compensate import CompensateOptions, CompensationTask
from counterlight.tools.solve.quality import measure
from counterlight.tools.solve.registry import SOLVERS, prepare
from counterlight.tools.solve.svd import svd
from counterlight.tools.transport.transport import Transport, channel
from tests.one_channel import System, beside_dark, certificate, linear_system, relative_gap, solve
from tests.programs import command, fail, succeed
from tests.rooms import blurred_transport, write_blurred_room
from tests.test_relight import far_transport

CAMERA, PROJECTOR = (18, 26), (14, 20)
SEEDS = st.integers(0, 2**32 - 1)
Problem = tuple[np.ndarray, np.ndarray]


def random_problem(rng: np.random.Generator, largest: int = 24) -> Problem:
    """Return a sparse non-negative T of several clusters, of any shape, and a target that no drive reaches exactly."""
    m, n = rng.integers(1, largest, 2)
    T = rng.uniform(size=(m, n)) * (rng.uniform(size=(m, n)) < 0.3)
    return T, T @ rng.uniform(-0.3, 1.3, n) + 0.2 * rng.normal(size=m)


def in_reach(system: System) -> float:
    """Return the squared error that the certificate's tolerance allows above the optimum."""
    found = certificate(system, solve("box", system).drive)
    return TOLERANCE * max(found.squared_error[0], 1e-6 * float(system.target @ system.target)) + 1e-15


@settings(max_examples=20, deadline=None)
@given(seed=SEEDS)
def test_box_is_never_worse_than_any_clamped_solution(seed: int) -> None:
    rng = np.random.default_rng(seed)
    system = linear_system(*random_problem(rng))
    best = system.squared_error(solve("box", system).drive)
    others = [solve(name, system).drive for name in SOLVERS] + [rng.uniform(size=system.shape[1])]
    assert best <= min(map(system.squared_error, others)) + in_reach(system)


@settings(max_examples=60, deadline=None)
@given(seed=SEEDS)
def test_box_is_scipys_bounded_optimum(seed: int) -> None:
    T, b = random_problem(np.random.default_rng(seed))
    system = linear_system(T, b)
    found = solve("box", system)
    cost = 0.5 * system.squared_error(found.drive)
    assert cost - lsq_linear(T, b, (0, 1), method="bvls", tol=1e-12).cost <= in_reach(system)
    assert relative_gap(system, found.drive) <= TOLERANCE


def test_a_small_system_may_take_thousands_of_steps() -> None:
    # 20 unknowns, 13 equations: the residual is small, so the gap must be tiny
    T, b = random_problem(np.random.default_rng(2317))
    system = linear_system(T, b)
    found = solve("box", system)
    assert int(found.notes[0].split()[-2]) > MOST_STEPS
    assert relative_gap(system, found.drive) <= TOLERANCE


@settings(max_examples=60, deadline=None)
@given(seed=SEEDS)
def test_the_certificate_bounds_the_distance_of_any_drive(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T, b = random_problem(rng)
    system, p = linear_system(T, b), rng.uniform(size=T.shape[1])
    distance = 0.5 * system.squared_error(p) - lsq_linear(T, b, (0, 1), method="bvls", tol=1e-12).cost
    assert certificate(system, p).gap[0] >= distance - 1e-12


@settings(max_examples=40, deadline=None)
@given(seed=SEEDS)
def test_nnls_is_scipys(seed: int) -> None:
    T, b = random_problem(np.random.default_rng(seed))
    p, residual = nnls(T, b)
    system = linear_system(T, b)
    found = solve("nnls", system).unclamped
    assert found.min(initial=0.0) >= 0
    assert np.sqrt(system.squared_error(found)) <= residual + 1e-6 * max(1.0, residual)
    if np.linalg.matrix_rank(T, tol=1e-6) == T.shape[1]:
        np.testing.assert_allclose(found, p, atol=1e-6)


@settings(max_examples=20, deadline=None)
@given(seed=SEEDS, solver=st.sampled_from(["qr", "svd"]))
def test_least_squares_is_of_minimum_norm(seed: int, solver: str) -> None:
    T, b = random_problem(np.random.default_rng(seed))
    expected = np.linalg.pinv(T, rcond=1e-7) @ b
    np.testing.assert_allclose(
        solve(solver, linear_system(T, b)).unclamped, expected, atol=1e-7 * (1 + abs(expected).max())
    )


def test_qr_says_when_a_cluster_is_rank_deficient() -> None:
    T = np.zeros((4, 4))
    T[:2, :2] = [[1, 2], [2, 4]]  # rank 1
    T[2:, 2:] = [[1, 0.5], [0.25, 1]]
    found = solve("qr", linear_system(T, np.ones(4)))
    assert found.notes == ("1 of 2 clusters are rank-deficient; svd took them",)
    np.testing.assert_allclose(found.unclamped, np.linalg.pinv(T) @ np.ones(4), atol=1e-12)


def test_direct_mapping_divides_by_the_floodlight() -> None:
    T = np.array([[0.5, 0.3, 0.0], [0.1, 0.4, 0.0]])
    found = solve("direct", linear_system(T, np.array([0.4, 0.25])))
    np.testing.assert_allclose(found.unclamped, [0.4 / 0.8, 0.25 / 0.5, 0.0])


def test_scale_and_order_of_pixels_do_not_matter(rng: np.random.Generator) -> None:
    T = sparse.random_array((30, 12), density=0.3, rng=rng).toarray() + np.eye(30, 12)
    b = T @ rng.uniform(-0.3, 1.3, 12) + 0.2 * rng.normal(size=30)
    rows, columns = rng.permutation(T.shape[0]), rng.permutation(T.shape[1])
    for name in SOLVERS:
        expected = solve(name, linear_system(T, b)).drive
        for scale in (1e-6, 1e6):
            np.testing.assert_allclose(solve(name, linear_system(scale * T, scale * b)).drive, expected, atol=1e-6)
        permuted = solve(name, linear_system(T[rows][:, columns], b[rows])).drive
        np.testing.assert_allclose(permuted, expected[columns], atol=1e-3 if name == "box" else 1e-6)


def test_what_is_not_finite_is_refused_by_its_cluster() -> None:
    T = np.eye(5)
    T[3, 3] = np.nan
    with pytest.raises(NonFiniteError, match=r"camera pixel 3 \(cluster 3 of 5, 1 camera x 1 projector pixels"):
        linear_system(T, np.ones(5))
    with pytest.raises(NonFiniteError, match="overflows in cluster 0"):
        svd(Channel(sparse.csr_array([[1e-300]]))).solve(np.array([1e200]))


def test_large_clusters_go_another_way(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    blur = blurred_transport(rng, (12, 16), (10, 13), 0.4).toarray()
    T = np.block([[blur, np.zeros((192, 1))], [np.zeros((1, 130)), 0.5]])
    b = T @ rng.uniform(size=131)
    monkeypatch.setattr("counterlight.tools.solve.clusterwise.LARGEST_BLOCK", 100)
    for name in ("qr", "svd", "nnls"):
        found = solve(name, linear_system(T, b))
        assert found.notes[0].startswith("1 clusters of up to 130 projector pixels: ")
        assert np.linalg.norm(T @ found.unclamped - b) < 1e-2 * np.linalg.norm(b)
        np.testing.assert_allclose(found.unclamped[-1], b[-1] / 0.5)


def test_far_light_is_part_of_the_system(rng: np.random.Generator) -> None:
    transport = far_transport(rng)
    mask = rng.uniform(size=transport.shape[0]) < 0.8
    b = rng.uniform(size=(transport.shape[0], 3))
    green = Channel.of(transport.inside(mask), 1)
    assert transport.far is not None
    far = channel(transport.far.scatter, 1) @ transport.far.mix.matrices[1] @ channel(transport.far.gather, 1).toarray()
    T = (channel(transport.near, 1).toarray() + far) * mask[:, None]
    p, c = rng.uniform(size=T.shape[1]), rng.uniform(size=T.shape[0])
    np.testing.assert_allclose(green.operator.matvec(p), T @ p)
    np.testing.assert_allclose(green.operator.rmatvec(c), T.T @ c)
    np.testing.assert_allclose((green.alone() @ beside_dark(p))[:, 0], T @ p)
    np.testing.assert_allclose((green.alone().T @ beside_dark(c))[:, 0], T.T @ c)
    best = lsq_linear(T, mask * b[:, 1], (0, 1), method="bvls").cost
    drive = prepare("box", transport, mask).solve(b).drive[:, 1]
    assert 0.5 * np.sum((T @ drive - mask * b[:, 1]) ** 2) <= best * (1 + 2 * TOLERANCE)
    by_svd = prepare("svd", transport, mask).solve(b).unclamped[:, 1]
    assert LeastSquares(green).solve(mask * b[:, 1])[0] == pytest.approx(by_svd)


@pytest.mark.parametrize("solver", SOLVERS)
def test_prepared_once_a_solver_gives_what_it_gives_anew(rng: np.random.Generator, solver: str) -> None:
    near = [blurred_transport(rng, (12, 16), (10, 13), 0.4) for _ in range(3)]
    T, pictures = Transport.from_matrices(near, camera=(12, 16)), rng.uniform(size=(2, 12, 16, 3))
    once = prepare(solver, T)
    for b in pictures:
        np.testing.assert_array_equal(once.solve(b).unclamped, prepare(solver, T).solve(b).unclamped)


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_channel_is_solved_alike_next_to_much_brighter_channels(rng: np.random.Generator, solver: str) -> None:
    near, b = blurred_transport(rng, (12, 16), (10, 13), 0.4), rng.uniform(size=(12 * 16, 3))

    def green(scales: Sequence[float]) -> FloatArray:
        T = Transport.from_matrices([scale * near for scale in scales], camera=(12, 16))
        return prepare(solver, T).solve(b * scales).unclamped[:, 1]

    np.testing.assert_allclose(green((1e4, 1e-4, 1e6)), green((1, 1, 1)), atol=0.01)


def test_interrupts_reach_the_pool() -> None:
    def refuse(blocks: np.ndarray) -> Blockwise:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Clusterwise(Channel(sparse.csr_array(np.eye(3))), refuse, "")


def test_factors_beyond_what_is_kept_are_made_for_each_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    T, b = random_problem(np.random.default_rng(7))
    kept = solve("svd", linear_system(T, b)).unclamped
    monkeypatch.setattr("counterlight.tools.solve.clusterwise.MOST_KEPT", 0)
    np.testing.assert_array_equal(solve("svd", linear_system(T, b)).unclamped, kept)


def test_quality_of_known_differences(rng: np.random.Generator) -> None:
    mask = np.ones((16, 20), bool)
    mask[:, 15:] = False
    desired = 0.4 * rng.uniform(0.2, 0.8, (16, 20, 3))
    same = measure(desired, np.where(mask[..., None], desired, 9.0), mask, 0.4)
    assert (same.rmse, same.ssim, same.ciede2000) == (0, 1, 0)
    seen = desired + 0.004
    found = measure(desired, seen, mask, 0.4)
    assert found.rmse == pytest.approx(0.01)
    assert found.psnr == pytest.approx(40)
    codes = Response("srgb").inverse_table()[:, 0]
    grid = np.linspace(0, 1, len(codes))
    lab = [rgb2lab(np.interp(np.sqrt(c / 0.4), grid, codes)) for c in (desired, seen)]
    assert found.ciede2000 == pytest.approx(float(deltaE_ciede2000(*lab)[mask].mean()), abs=2e-3)
    assert 0.9 < found.ssim < 1


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> tuple[StoredCalibration, Path]:
    """Return a blurred wall with its correction map, and a picture for it."""
    folder = tmp_path_factory.mktemp("solve")
    write_blurred_room(folder / "wall", np.random.default_rng(3), CAMERA, PROJECTOR)
    assert build_correction_map.main([str(folder / "wall")]) == 0
    picture = cv2.GaussianBlur(np.random.default_rng(4).integers(0, 256, (36, 52, 3), np.uint8), (0, 0), 3)
    cv2.imwrite(str(folder / "picture.png"), picture)
    return calibration.read(folder / "wall"), folder / "picture.png"


def test_command_compares_all_solvers(room: tuple[StoredCalibration, Path], tmp_path: Path) -> None:
    stored, picture = room
    out = succeed("compensate", stored.folder, picture, "--solver", "all", "--drift", 0, "-o", tmp_path / "p.exr")
    table = {line.split()[0]: [float(v) for v in line.split()[1:]] for line in out.splitlines() if line.count(".") > 4}
    assert list(table) == ["none", "direct", "triangulated", "map", "qr", "svd", "nnls", "box"]
    assert all(row[6] >= -1e-3 for row in table.values())
    assert table["box"][4] == table["box"][6] == 0
    assert table["none"][1] < table["direct"][1] < table["triangulated"][1] < table["map"][1]
    assert table["none"][7] == 100
    assert table["box"][7] < 100  # unseen pixels are darker than without compensation
    drive = exr.read_rgb(tmp_path / "p-box.exr")
    assert drive.shape == (*PROJECTOR, 3)
    assert 0 <= drive.min() < drive.max() <= 1


def test_command_writes_code_values_by_default(room: tuple[StoredCalibration, Path], tmp_path: Path) -> None:
    stored, picture = room
    for suffix in ("png", "exr"):
        out = succeed("compensate", stored.folder, picture, "-o", tmp_path / f"p.{suffix}")
        assert "gap" not in out
        assert out.splitlines()[-1].startswith(f"{picture}: compensated by box; next: counterlight verify ")
    assert "    red: relative gap " in succeed("compensate", stored.folder, picture, "--verbose")
    codes = cv2.imread(str(tmp_path / "p.png"))[..., ::-1]
    light = exr.read_rgb(tmp_path / "p.exr").astype(np.float64)
    np.testing.assert_allclose(Response("srgb").to_linear(codes / 255), light, atol=0.006)


def test_decomposed_solvers_come_close_despite_far_light(rng: np.random.Generator) -> None:
    transport = far_transport(rng)
    camera, projector = (11, 17), (7, 13)
    devices = Device(*projector, Response("linear")), Device(*camera, Response("linear"))
    room = Calibration(
        "far", "a test", devices[:1], devices[1], np.zeros((*camera, 3), np.float32), np.ones(camera, bool)
    )
    task = CompensationTask(
        tier_of(room, transport),
        rng.uniform(0.2, 0.6, (*camera, 3)),
        radiance=False,
        options=CompensateOptions(("svd", "box"), 10_000),
    )
    svd, box = task.run(np.zeros((*projector, 3)))
    assert svd.below_optimum >= 0
    assert any("far light from the clamped drive" in note for note in svd.notes)
    assert box.quality.psnr >= svd.quality.psnr


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--solver", "magic"], "--solver magic: expected all, or of none, direct"),
        (["--max-cluster", "0", "--solver", "svd"], "--max-cluster 0: expected at least 1 projector pixel"),
        (["-o", "nowhere/p.png"], "no such folder"),
        (["-o", "p.tiff"], "cannot write .tiff"),
        (["--white", "-1"], "--white"),
    ],
)
def test_command_refuses_in_one_line(
    room: tuple[StoredCalibration, Path], tmp_path: Path, arguments: list[str], says: str
) -> None:
    stored, picture = room
    assert says in fail("compensate", stored.folder, picture, *arguments)


def test_command_needs_a_map_and_a_fitting_picture(room: tuple[StoredCalibration, Path], tmp_path: Path) -> None:
    write_blurred_room(tmp_path / "bare", np.random.default_rng(3), CAMERA, PROJECTOR)
    done = command("compensate", tmp_path / "bare", room[1], "--solver", "direct,map", "-o", tmp_path / "p.png")
    assert "rebuild it with: counterlight build" in done.stderr
    assert (done.returncode, "direct" in done.stdout, list(tmp_path.glob("p*.png"))) == (2, False, [])
    exr.write_rgb(tmp_path / "small.exr", np.ones((4, 5, 3), np.float32))
    assert "5x4" in fail("compensate", room[0].folder, tmp_path / "small.exr")


def test_colours_that_the_projector_cannot_show_count_as_clipped_and_as_errors(rng: np.random.Generator) -> None:
    """On a wall of one camera pixel per projector pixel, a primary alone arrives at 80 % of its share of white."""
    shape = (4, 6)
    samples = tuple((1.0, 1.0, 1.0) if number == LEVELS**3 - 1 else (0.8, 0.8, 0.8) for number in range(LEVELS**3))
    dull = Device(*shape, Response("srgb", processing=Processing(samples)))
    T = sparse.csr_array(sparse.eye_array(shape[0] * shape[1]), dtype=np.float32)
    ambient = np.zeros((*shape, 3), np.float32)
    room = Calibration("dull", "a test", (dull,), Device(*shape, Response("linear")), ambient, np.ones(shape, bool))
    picture = np.full((*shape, 3), 0.5)
    picture[:2] = 1, 0, 0
    task = CompensationTask(
        tier_of(room, Transport.from_matrices((T, T, T))), picture, radiance=False, options=CompensateOptions(("box",))
    )
    (found,) = task.run(picture)
    # only red, one of three channels, is clipped, in half of the picture
    assert found.clipped == pytest.approx(1 / 6, abs=1e-9)
    assert found.quality.psnr == pytest.approx(-10 * np.log10(0.2**2 / 6), abs=0.01)

"""counterlight build --report: its figures recomputed, its pictures, and nothing half-written."""

import json
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy import sparse

from counterlight import calibration
from counterlight.calibration import Calibration, Device
from counterlight.maps import room_maps as maps
from counterlight.maps.room_maps import RoomMaps
from counterlight.maps.row_map import unpack
from counterlight.response import Response
from counterlight.tools.colour.tiers import tier_of
from counterlight.tools.report import acquired, report
from counterlight.tools.report.acquired import predicted_quality
from counterlight.tools.report.charts import bins_of
from counterlight.tools.report.impossible import REASONS, find_impossible
from counterlight.tools.report.pictures import cluster_picture, matrix_picture, texture_picture, transport_picture
from counterlight.tools.solve.box import Box
from counterlight.tools.transport.objective import Objective
from counterlight.tools.transport.storage import read_transport
from counterlight.tools.transport.transport import Transport, channels, far_light_of, in_one, luminance_matrix
from tests.blurred_rooms import CAMERA as BLURRED_CAMERA
from tests.blurred_rooms import PROJECTOR as BLURRED_PROJECTOR
from tests.blurred_rooms import calibrated, discs, rows_of
from tests.packing import pack_matrices
from tests.programs import fail, succeed
from tests.rooms import write_blurred_room

ROOM_CAMERA, ROOM_PROJECTOR = (12, 18), (9, 14)
NAMES = [reason.name for reason in REASONS]


@pytest.fixture(scope="module")
def reported(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Return a room and its report."""
    folder = tmp_path_factory.mktemp("report")
    write_blurred_room(folder / "wall", np.random.default_rng(5), ROOM_CAMERA, ROOM_PROJECTOR)
    out = succeed("build", folder / "wall", "--report", folder / "report")
    assert f"report: {folder / 'report' / 'index.html'}" in out.splitlines()
    return folder / "wall", folder / "report"


def one_pixel_rooms(T: np.ndarray, ambient: np.ndarray, mask: np.ndarray, white: float) -> np.ndarray:
    """Return the flags of the impossible map, (reasons, camera pixels), of a grey room with one row.

    T : (camera, projector).
    """
    matrix = sparse.csr_array(T.astype(np.float32))
    camera, projector = (1, T.shape[0]), (1, T.shape[1])
    room = Calibration(
        "row",
        "made by a test",
        (Device(*projector, Response("linear")),),
        Device(*camera, Response("linear")),
        np.repeat(ambient.astype(np.float32).reshape(*camera, 1), 3, axis=2),
        mask.reshape(camera),
    )
    inverse = sparse.csr_array(np.linalg.pinv(T))
    packed = [pack_matrices([m] * 3, a, b) for m, a, b in ((inverse, projector, camera), (matrix, camera, projector))]
    room_maps = RoomMaps(packed[0], packed[1], None, None, white)
    return find_impossible(tier_of(room, Transport.from_matrices((matrix,) * 3)), room_maps).flags[:, 0]


def test_each_reason_is_found_where_it_was_put() -> None:
    """One camera pixel per reason: masked, dark, dim, dimmer than white, bright by itself, without a reason.

    Two more share a pixel.
    """
    T = np.zeros((8, 7))
    np.fill_diagonal(T, [1, 0, 0.4, 0.8, 1, 1, 1])
    T[7, 6] = 10  # the last two see the same projector pixel, one of them ten times as bright, so both cannot be grey
    ambient = np.array([0, 0, 0, 0, 0.2, 0, 0, 0.0])
    mask = np.array([False] + [True] * 7)
    flags = one_pixel_rooms(T, ambient, mask, 1.0)
    found = [{name for name, flag in zip(NAMES, column, strict=True) if flag} for column in flags.T]
    assert found == [
        {"unlit"},
        {"unlit"},
        {"below_mid_grey", "below_white"},
        {"below_white"},
        {"bright_black"},
        set(),
        {"conflict"},
        set(),  # the bright pixel dominates the least squares p = 5.5 / 101, and misses its target by 0.0446 < 0.05
    ]


def test_the_figures_are_those_of_the_room(reported: tuple[Path, Path]) -> None:
    folder, where = reported
    stored = calibration.read(folder)
    transport, room = read_transport(stored), maps.read_maps(stored)
    figures = json.loads((where / "report.json").read_text())
    floodlight = transport.composition().reshape(*ROOM_CAMERA, 3) + stored.calibration.ambient
    assert figures["white"] == room.white
    median = figures["floodlight_inside_mask"]["percentile_50"]
    assert median == pytest.approx(np.median(floodlight), rel=1e-9)  # float64 rounding
    lengths = unpack(room.correction).lengths
    assert figures["rows"]["entries"] == lengths.sum()
    assert figures["rows"]["longest"] == lengths.max()
    assert sum(count for _, _, count in figures["rows"]["length_bins"]) == lengths.size
    assert figures["texture"]["fill"] == room.correction.fill
    assert figures["damping"]["chosen"] == room.details["inverse"]["damping"]
    assert len(figures["damping"]["candidates"]) == len(room.details["inverse"]["damping_errors"])
    below = (floodlight.min(axis=2) < room.white * (1 - 1e-6)).sum()
    assert figures["impossible"]["below_white"]["all"] == below > 0
    shown = [counts["shown"] for counts in figures["impossible"].values()]
    assert sum(shown) == ROOM_CAMERA[0] * ROOM_CAMERA[1]


def test_condition_and_rank_are_numpys(reported: tuple[Path, Path]) -> None:
    folder, where = reported
    transport = read_transport(calibration.read(folder))
    weights = (0.2126, 0.7152, 0.0722)  # ITU-R BT.709
    luminance = sum(w * T.toarray().astype(float) for w, T in zip(weights, channels(transport.near), strict=True))
    sigma = np.linalg.svd(luminance[:, luminance.any(axis=0)], compute_uv=False)
    figures = json.loads((where / "report.json").read_text())
    assert figures["clusters"]["count"] == 1  # blur connects all pixels
    (system,) = figures["spectra"]["systems"]
    assert system["kind"] == "cluster"
    assert system["rank_deficit"] == 0
    assert system["condition"] == pytest.approx(sigma[0] / sigma[-1], rel=1e-4)  # the sum of channels may be float32


def test_the_page_shows_every_picture_and_loads_nothing_else(reported: tuple[Path, Path]) -> None:
    where = reported[1]
    page = (where / "index.html").read_text()
    named = set(re.findall(r'src="([^"]+)"', page))
    assert named == {path.name for path in where.glob("*.png")}
    assert {path.name for path in where.iterdir()} == named | {"index.html", "report.json"}
    assert "http" not in page
    assert "url(" not in page
    for name in named:
        assert cv2.imread(str(where / name)) is not None
    assert cv2.imread(str(where / "impossible.png")).shape == (*ROOM_CAMERA, 3)


def test_the_matrix_picture_holds_far_light_as_if_entry_by_entry(rng: np.random.Generator) -> None:
    m, n, cells = 700, 530, 5  # larger than the side of the picture, and not a multiple of it

    def random(shape: tuple[int, int], density: float) -> list[sparse.csr_array]:
        return [sparse.random_array(shape, density=density, rng=rng, dtype=np.float32).tocsr() for _ in range(3)]

    far = far_light_of(random((cells, n), 0.5), rng.uniform(size=(3, cells, cells)), random((m, cells), 0.5))
    T = Transport.from_matrices(random((m, n), 0.02), far)
    expected = matrix_picture(luminance_matrix(in_one(T))).astype(int)
    assert np.abs(transport_picture(T).astype(int) - expected).max() <= 1  # T as a single matrix has float32 entries
    assert (transport_picture(T) > 0).mean() > 0.5 > (transport_picture(T.without_far) > 0).mean()


def test_pictures_of_structure() -> None:
    labels = np.array([-1, 0, 1, 1, 2, 0])
    picture = cluster_picture(labels, (2, 3)).reshape(-1, 3)
    assert len({tuple(colour) for colour in picture}) == 4
    assert (picture[2] == picture[3]).all()
    matrix = sparse.csr_array(np.array([[1.0, 0.0], [0.0, 1e-2]]))
    assert matrix_picture(matrix)[..., 0].tolist() == [[255, 0], [0, 128]]  # two of four decades: 127.5, rounded
    packed = pack_matrices([sparse.csr_array(np.tri(5, 7))] * 3, (1, 5), (1, 7))
    assert texture_picture(packed).mean() == pytest.approx(255 * packed.fill, abs=0.5)  # each value is rounded


@pytest.mark.parametrize("values", [[3, 3, 3], [0, 1, 5, 1000], list(range(60)), [0, 0]])
def test_every_value_is_in_one_bin(values: list[int]) -> None:
    bins = bins_of(np.array(values))
    for low, high, count in bins:
        assert count == sum(low <= value <= high for value in values)
    assert sum(count for _, _, count in bins) == len(values)


def test_a_folder_that_is_no_report_is_refused_before_the_work(reported: tuple[Path, Path], tmp_path: Path) -> None:
    (tmp_path / "letters").mkdir()
    (tmp_path / "letters" / "a.txt").write_text("dear")
    before = (reported[0] / "correction" / "manifest.toml").stat().st_mtime_ns
    line = fail("build", reported[0], "--report", tmp_path / "letters")
    assert "is no report" in line
    assert (reported[0] / "correction" / "manifest.toml").stat().st_mtime_ns == before
    assert [path.name for path in tmp_path.rglob("*")] == ["letters", "a.txt"]


def test_a_report_that_fails_leaves_the_previous_one(
    reported: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "report.json").write_text("{}")

    def fall(*_: object) -> str:
        raise KeyboardInterrupt

    monkeypatch.setattr(report, "find", lambda _: report.Findings({}, {"a.png": np.zeros((2, 2, 3), np.uint8)}))
    monkeypatch.setattr(report.layout, "report_page", fall)
    with pytest.raises(KeyboardInterrupt):
        report.write_report(None, tmp_path / "old")  # type: ignore[arg-type]
    assert [path.name for path in tmp_path.rglob("*")] == ["old", "report.json"]
    assert (tmp_path / "old" / "report.json").read_text() == "{}"


@pytest.mark.parametrize("radius", [0.8, 4.0])
def test_a_report_on_an_acquisition_computes_the_optimum_in_few_steps(
    radius: float, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A certificate of 1e-4 takes 480 steps in focus and 900 far out of focus, and gives the same figures."""
    T = discs(rng, radius)
    transport = replace(Transport(rows_of(T)), camera=BLURRED_CAMERA, projector=BLURRED_PROJECTOR)
    steps, descent = list[int](), Objective.descent
    monkeypatch.setattr(Objective, "descent", lambda *given: (steps.append(1), descent(*given))[1])
    found = predicted_quality(transport, calibrated(transport), 0.01)
    assert len(steps) < 400
    monkeypatch.undo()
    monkeypatch.setattr(acquired, "Box", lambda T, **_: Box(T, tolerance=1e-4))
    for name, best in predicted_quality(transport, calibrated(transport), 0.01).items():
        assert found[name]["by_transport"] == pytest.approx(best["by_transport"], abs=0.1)  # dB, as on the page
        assert found[name]["with_check_error"] < found[name]["by_transport"]

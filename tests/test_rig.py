"""The rig that judges the product: its cameras, devices, optimum and figures."""

import ast
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy import sparse
from scipy.optimize import lsq_linear

from tests.rig import product
from tests.rig.asked import reachable
from tests.rig.faults import FAULTS
from tests.rig.judge import Figures, Judge, Outside
from tests.rig.lattice import FINE, Lattice
from tests.rig.optimum import Problem, box_optimum
from tests.rig.pictures import PICTURES, Picture
from tests.rig.projector import Projector
from tests.rig.rig import Devices, Rig
from tests.rig.rooms import ROOMS
from tests.rig.sensor import Sensor
from tests.rig.table import markdown, rows, text_of_csv
from tests.rig.texture import sampled
from tests.rig.trial import Verdict
from tests.rig.view import Transport
from tests.small_rigs import small_rig, small_room

RIG = Path(__file__).parent / "rig"


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(14)


def test_the_rig_imports_nothing_of_the_product() -> None:
    found = set()
    for path in RIG.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom):
                found.add((node.module or "").partition(".")[0])
            elif isinstance(node, ast.Import):
                found |= {name.name.partition(".")[0] for name in node.names}
    assert "numpy" in found
    assert not found & {"player", "tools", "counterlight"}


@pytest.mark.parametrize("name", ROOMS)
def test_matrices_and_rays_tell_the_same(name: str, rng: np.random.Generator) -> None:
    pixels = small_room(name).raster[0] * small_room(name).raster[1]
    u, v = rng.uniform(size=(2, pixels, 3))
    view, transport = small_rig(name).calibrated, small_rig(name).calibrated.transport()
    seen = view.rise(u)
    assert transport.apply(u) == pytest.approx(seen, abs=2e-5 * seen.max())  # float32 sums of some hundred terms
    assert view.rise(u + 2 * v) == pytest.approx(seen + 2 * view.rise(v), abs=2e-5 * seen.max())
    light_ = rng.uniform(size=seen.shape)
    assert np.sum(transport.adjoint(light_) * u) == pytest.approx(np.sum(light_ * transport.apply(u)), rel=1e-5)


@pytest.mark.parametrize("name", ROOMS)
def test_the_audience_sees_the_same_room(name: str, rng: np.random.Generator) -> None:
    codes = rng.integers(0, 256, (*small_room(name).raster, 3), np.uint8)
    lattice = small_room(name).lattice
    wide = small_rig(name).seen_by_audience(codes).reshape(*lattice.audience, 3)
    means = wide.reshape(lattice.audience[0] // FINE, FINE, lattice.audience[1] // FINE, FINE, 3).mean(axis=(1, 3))
    (rows, columns), (height, width) = lattice.border, lattice.camera
    near = small_rig(name).seen(codes).reshape(height, width, 3)
    assert means[rows:-rows, columns:-columns] == pytest.approx(near, abs=2e-5 * near.max())  # rounding to float32


def test_a_camera_that_moves_by_four_samples_sees_its_neighbours_pixels() -> None:
    lattice = Lattice((12, 16))
    picture = np.random.default_rng(0).uniform(size=lattice.size[0] * lattice.size[1])
    still, moved = (lattice.calibrated(by) @ picture for by in ((0, 0), (4, -4)))
    assert moved.reshape(12, 16)[1:, :-1] == pytest.approx(still.reshape(12, 16)[:-1, 1:], rel=1e-6)


def test_texture_is_finer_than_a_pixel() -> None:
    paint = small_room("wall").paint[:, 1].reshape(small_room("wall").lattice.size)
    assert np.abs(np.diff(paint, axis=1)).max() > 0.05


def test_paint_is_found_where_it_was_put() -> None:
    paint = np.random.default_rng(1).uniform(size=(5, 7, 2)).astype(np.float32)
    middles = np.stack([(np.arange(7) + 0.5) / 7, np.full(7, 2.5 / 5)], axis=1)
    assert sampled(paint, middles) == pytest.approx(paint[2], abs=1e-6)


def test_photon_noise_has_the_variance_of_its_electrons() -> None:
    sensor, weakness = Sensor(16, 20000.0, 5.0), np.array([1.0, 1.5, 2.0])
    shots = sensor.codes(np.full((200_000, 3), 0.3), weakness, np.random.default_rng(3)) / 65535
    electrons = 0.3 * 20000 / weakness
    assert shots.mean(axis=0) == pytest.approx(0.3, abs=1e-4)  # the standard error, 0.005 / √200 000, is 1.2e-5
    expected = (electrons + 25) * (weakness / 20000) ** 2
    # the relative standard error, √(2 / 200 000), is 0.3 %
    assert shots.var(axis=0) == pytest.approx(expected, rel=0.02)


def test_a_sensor_without_noise_only_rounds() -> None:
    radiance = np.linspace(-0.1, 1.1, 4001)[:, None].repeat(3, axis=1)
    codes = Sensor(14, 0.0).codes(radiance, np.ones(3), np.random.default_rng(0))
    assert len(np.unique(codes)) <= 1 << 14
    assert codes / 65535 == pytest.approx(np.clip(radiance, 0, 1), abs=0.5 / (2**14 - 1) + 1 / 65535)


def test_photographs_repeat_and_do_not_saturate() -> None:
    white = np.full((*small_room("glass").raster, 3), 255, np.uint8)
    first, again, other = (small_rig("glass").photograph(white, seed) for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)
    assert 0.85 * 65535 < first.max() < 65535


def test_codes_and_light_are_each_other_s_inverse(rng: np.random.Generator) -> None:
    codes = rng.integers(0, 256, (5, 7, 3), np.uint8)
    for projector in (Projector(), Projector(gammas=None, black=0.0), Projector(white_segment=0.4, lamp=0.7)):
        assert np.array_equal(projector.nearest_codes(projector.light(codes), (5, 7)), codes)
    assert Projector(gammas=None).curve(np.array([0.5, 0.5, 0.5])) == pytest.approx(0.21404, abs=1e-5)


def test_a_white_segment_adds_to_grey_alone() -> None:
    plain, segment = Projector(), Projector(white_segment=0.4)
    red, white = np.zeros((1, 1, 3), np.uint8), np.full((1, 1, 3), 255, np.uint8)
    red[..., 0] = 255
    assert np.array_equal(plain.light(red), segment.light(red))
    assert segment.light(white) == pytest.approx(segment.brightest)
    assert segment.brightest / plain.brightest == pytest.approx(1.4, rel=1e-3)  # the two differ by the black level


def test_colour_processing_brightens_saturated_colours_and_is_undone(rng: np.random.Generator) -> None:
    plain, vivid = Projector(), Projector(vividness=(0.25, 0.2, 0.15))
    white, red = np.full((1, 1, 3), 255, np.uint8), np.array([[[255, 0, 0]]], np.uint8)
    assert vivid.light(white) == pytest.approx(plain.light(white))
    assert vivid.light(red)[0, 0] / plain.light(red)[0, 0] == pytest.approx(1.25, rel=1e-3)  # black is not brightened
    codes = rng.integers(0, 256, (9, 11, 3), np.uint8)
    shown = vivid.light(vivid.nearest_codes(vivid.light(codes), (9, 11)))
    # Red and blue may share the error of a step of green.
    assert np.abs(shown - vivid.light(codes)).max() < 0.012


def test_a_wandering_gain_is_of_a_capture_and_a_channel() -> None:
    sensor, rng = Sensor(16, 0.0, wander=0.025), np.random.default_rng(5)
    shots = np.stack([sensor.codes(np.full((2, 3), 0.5), np.ones(3), rng) for _ in range(400)]) / 65535
    assert np.array_equal(shots[:, 0], shots[:, 1])
    assert shots.std(axis=0) == pytest.approx(0.5 * 0.022, rel=0.15)  # a Gaussian clipped at 2 σ; 400 captures


def test_changes_are_seen_where_they_belong() -> None:
    before = small_rig("wall", "separate")
    codes = np.full((*before.raster, 3), 128, np.uint8)
    lamp = before.after(replace(before.devices, projector=Projector(lamp=0.5)))
    assert (lamp.seen(codes) - lamp.ambient) == pytest.approx((before.seen(codes) - before.ambient) / 2, rel=1e-5)
    room_light = before.after(replace(before.devices, room_light=0.03))
    assert room_light.ambient == pytest.approx(3 * before.ambient)
    moved = before.after(replace(before.devices, camera_moved=(2, 0)))
    assert not np.array_equal(moved.photograph(codes, 1), before.photograph(codes, 1))
    assert moved.seen(codes) == pytest.approx(before.seen(codes))  # the observer does not move


def test_the_optimum_is_scipy_s(rng: np.random.Generator) -> None:
    T = np.where(rng.uniform(size=(90, 24)) < 0.4, rng.uniform(size=(90, 24)), 0)
    target, counted = rng.uniform(0, 4, (30, 3)), rng.uniform(size=30) < 0.8
    transport = Transport(sparse.csr_array(T, dtype=np.float32))
    found = box_optimum(Problem(transport, target, counted, 0.01, 1.0), 1e-7)
    rows = np.tile(counted, 3)
    best = lsq_linear(T[rows], target.T.ravel()[rows], (0.01, 1.0), tol=1e-12)
    assert found.half_squares == pytest.approx(best.cost, rel=1e-5)  # float32 products
    assert found.drive.T.ravel() == pytest.approx(best.x, abs=2e-3)
    early = box_optimum(Problem(transport, target, counted, 0.01, 1.0), 0.05)
    assert early.half_squares - early.gap <= best.cost <= early.half_squares * (1 + 1e-6)


def test_a_pixel_alone_shows_the_nearest_that_its_primaries_can(rng: np.random.Generator) -> None:
    flood, dark = rng.uniform(0, 1, (40, 3, 3)) + 2 * np.eye(3), rng.uniform(0, 0.1, (40, 3))
    wanted = rng.uniform(0, 5, (40, 3))
    found = reachable(wanted, dark, flood)
    for i in range(40):
        best = lsq_linear(flood[i], wanted[i] - dark[i], (0, 1), tol=1e-12)
        assert found[i] == pytest.approx(dark[i] + flood[i] @ best.x, abs=1e-4)


def test_the_optimum_is_well_above_what_is_projected_plainly_and_darkness_is_no_flare() -> None:
    room_rig = small_rig("wall", "12 %")
    judge, picture = Judge(room_rig), PICTURES["astronaut"](room_rig.camera)
    plain = cv2.resize(picture.srgb, room_rig.raster[::-1], interpolation=cv2.INTER_AREA)
    question = judge.asks(picture, 0.25, plain)
    asked = question.near
    projector = room_rig.devices.projector
    target = asked.most - room_rig.ambient
    best = box_optimum(Problem(room_rig.transport, target, asked.counted, projector.black, 1.0), 0.01)
    codes = projector.nearest_codes(best.drive, room_rig.raster)
    shown, plainly = (judge.figures(question, each) for each in (codes, plain))
    assert shown.psnr > 25 > 15 > plainly.psnr
    assert shown.inside > 30
    assert shown.delta_e < 4 < plainly.delta_e
    assert plainly.everywhere >= plainly.psnr  # outside the view, plain projection is as good as any other drive
    black = np.zeros_like(codes)
    assert judge.outside(question, black).flare == pytest.approx(0, abs=1e-6)
    assert judge.outside(question, np.full_like(codes, 255)).flare > judge.outside(question, plain).flare > 0


def test_a_flare_beside_the_view_lowers_what_is_seen_everywhere_and_nothing_else() -> None:
    room_rig = Rig(ROOMS["defocus"](0.4), Devices())
    judge, picture = Judge(room_rig), PICTURES["ramps"](room_rig.camera)
    grey = np.full((*room_rig.raster, 3), 100, np.uint8)
    question = judge.asks(picture, 0.25, grey)
    pixels = room_rig.camera[0] * room_rig.camera[1]
    unseen = room_rig.transport.adjoint(np.ones((pixels, 3))).sum(axis=1) == 0
    flare = grey.reshape(-1, 3).copy()
    flare[unseen] = 255, 0, 0
    calm, flaring = (judge.figures(question, codes) for codes in (grey, flare.reshape(grey.shape)))
    assert flaring.psnr == pytest.approx(calm.psnr, abs=1e-6)
    assert flaring.everywhere < calm.everywhere - 0.05  # few pixels change next to a picture that is wrong everywhere


def test_pictures_stand_where_the_product_puts_them() -> None:
    picture = PICTURES["coffee"]((120, 160))
    placed, inside = picture.placed((120, 160))
    assert picture.srgb.shape == (90, 160, 3)
    assert np.array_equal(np.flatnonzero(inside.any(axis=1)), np.arange(15, 105))
    assert not placed[~inside].any()
    assert Picture("grey", np.full((1, 1, 3), 188, np.uint8)).linear == pytest.approx(0.5029, abs=1e-4)


def test_the_table_has_a_row_of_means_for_each_room_and_condition() -> None:
    good, bad = Figures(40, 41, 38, 50, 1), Figures(20, 21, 18, 30, 9)
    calm = Outside(0.01, 0.2)
    swept = Verdict("wall", "known", "astronaut", good, good, calm, calm, {0: good, 4: bad}, {0: calm, 4: calm})
    plain = Verdict("wall", "known", "coffee", bad, good, calm, calm, {}, {})
    (row,) = rows([plain, swept])
    assert (row["captured, dB"], row["optimum, dB"], row["below, dB"]) == ("30.0", "40.0", "10.0")
    assert row["astronaut, everywhere, 0, 4 steps"] == "38.0 18.0"
    assert [line.split(",")[2] for line in text_of_csv([plain, swept]).splitlines()] == [
        "picture",
        "coffee",
        "astronaut",
    ]
    assert len({len(line) for line in markdown([plain, swept]).splitlines()}) == 1


def test_tiers_of_colour_have_rows_of_their_own() -> None:
    good, calm = Figures(40, 38, 41, 50, 1), Outside(0.01, 0.2)
    plain = Verdict("wall", "wheel", "coffee", good, good, calm, calm, {}, {})
    tiers = [replace(plain, colour=colour) for colour in ("global", "pixel")]
    assert [list(row.values())[:3] for row in rows(tiers)] == [["wall", "wheel", "global"], ["wall", "wheel", "pixel"]]
    assert "colour" not in rows([plain])[0]
    assert text_of_csv(tiers).startswith("room,fault,colour,picture,")


def test_conditions_share_a_calibration_only_if_they_may() -> None:
    assert FAULTS["drift"].acquisition == FAULTS["known"].acquisition
    assert FAULTS["response"].acquisition != FAULTS["known"].acquisition
    assert FAULTS["drift"].now.shift == (0.8, 0.6)


def test_the_product_is_photographed_built_and_shown(tmp_path: Path) -> None:
    room_rig = small_rig("wall", "separate")
    picture = PICTURES["ramps"](room_rig.camera)
    picture.write(tmp_path / "ramps.png")
    table = product.write_response(tmp_path / "response.toml", room_rig.devices.projector.response_table())
    said = product.acquire(room_rig, tmp_path, "--response", str(table))
    assert 40 < product.expected_decibels(said) < 60
    product.build(tmp_path)
    shown, plain = product.show(tmp_path, tmp_path / "ramps.png"), product.show_plain(tmp_path, tmp_path / "ramps.png")
    assert shown.codes.shape == (*room_rig.raster, 3)
    judge = Judge(room_rig)
    question = judge.asks(picture, shown.white, plain.codes)
    # Compensation must clearly beat plain projection. A mirrored or misplaced picture stays below 15 dB.
    assert judge.figures(question, shown.codes).psnr > judge.figures(question, plain.codes).psnr + 10

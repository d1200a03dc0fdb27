"""Refinement against independent answers: numpy's dense T, scipy's bounded least squares, closed forms."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import sparse
from scipy.optimize import lsq_linear

from counterlight import calibration
from counterlight.maps import room_maps as maps
from counterlight.maps.chain import Chain
from counterlight.maps.prior import Prior
from counterlight.maps.room_maps import RefinementMaps, RoomMaps
from counterlight.maps.row_map import PreparedRows
from counterlight.media.frames import radiance_frame
from counterlight.media.video import Frame
from counterlight.pipeline.content import CUT, SceneCuts
from counterlight.pipeline.cpu_renderer import CpuRenderer
from counterlight.pipeline.refinement import (
    LARGEST_MOMENTUM,
    OVER_RELAXATION,
    SHARE_OF_FRAME,
    STARTS,
    Certificate,
    StepBudget,
    momentum,
)
from counterlight.tools.inverse.build import build_room_maps
from counterlight.tools.inverse.near_light import InverseOptions
from tests.packing import pack_matrices
from tests.refined_rooms import DARK, PhysicalRoom, physical_room
from tests.rooms import CAMERA, rgb_frame, write_blurred_room


def desired(rng: np.random.Generator) -> Frame:
    """Return letters as bright as the room can show. The optimum has pixels at both bounds and between them."""
    return radiance_frame(rng.choice([0.02, 0.3, 0.9], (*CAMERA, 3)).astype(np.float32))


def refined(room: PhysicalRoom, frame: Frame, steps: int, start: str = "map") -> tuple[np.ndarray, Certificate]:
    renderer = CpuRenderer(replace(room.room, start=start))
    renderer.open(frame.format)
    renderer.upload(frame)
    renderer.render("projector", compensate=True, steps=steps)
    certificate = renderer.certificate()
    assert certificate is not None
    return renderer.linear().reshape(-1, 3).astype(float), certificate


def light(room: PhysicalRoom, frame: Frame) -> np.ndarray:
    """Return b = c − e, limited to what each pixel can show."""
    return np.asarray(np.clip(asked(room, frame), 0, room.dense.sum(axis=2).T))


def asked(room: PhysicalRoom, frame: Frame) -> np.ndarray:
    """Return c − e."""
    picture = np.stack([plane[: CAMERA[0], : CAMERA[1]] for plane in frame.planes], axis=-1)
    return np.asarray((picture.astype(float) - room.room.calibration.ambient).reshape(-1, 3))


def unbounded(room: PhysicalRoom) -> PhysicalRoom:
    """Return the room without bounds on b, as in chapter 5."""
    return replace(room, room=replace(room.room, maps=replace(room.room.maps, bounded=False)))


def squared_errors(room: PhysicalRoom, drive: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return ‖T p − b‖² inside the mask, per channel."""
    return np.array([np.sum((room.dense[i] @ drive[:, i] - b[:, i])[room.inside] ** 2) for i in range(3)])


def best_errors(room: PhysicalRoom, b: np.ndarray) -> np.ndarray:
    """Return the squared error of the best drive, by scipy's bounded-variable least squares."""
    systems = [(room.dense[i][room.inside], b[room.inside, i]) for i in range(3)]
    return np.array([2 * lsq_linear(T, channel, (0, 1), method="bvls", tol=1e-12).cost for T, channel in systems])


@pytest.mark.parametrize("far", [False, True])
def test_the_further_maps_are_those_of_the_dense_transport(rng: np.random.Generator, far: bool) -> None:
    room = physical_room(rng, far=far)
    further = room.room.maps.refinement
    assert further is not None
    assert (further.far_dual is not None) == far
    T = np.where(room.inside[:, None], room.dense, 0)
    picture = rng.normal(size=(*CAMERA, 3))
    dual, chained = PreparedRows(further.dual).apply(picture), picture
    if further.far_dual is not None:
        for packed in (further.far_dual.gather, further.far_dual.mix, further.far_dual.scatter):
            chained = PreparedRows(packed).apply(chained)
        dual += chained
    expected = np.stack([T[i].T @ picture[..., i].ravel() for i in range(3)], axis=1)
    np.testing.assert_allclose(dual.reshape(-1, 3), expected, atol=1e-5)  # T and its factors in float32
    d = np.stack([T[i].T @ T[i].sum(axis=1) for i in range(3)], axis=1)
    steps, lit = further.step_size.reshape(-1, 3), np.arange(T.shape[2]) != DARK
    assert np.all(steps[DARK] == 0)
    np.testing.assert_allclose(steps[lit] * d[lit], 1, rtol=1e-5)  # rounding to float32


def test_direct_mapping_asks_the_camera_pixel_that_is_lit_most(rng: np.random.Generator) -> None:
    room = physical_room(rng, far=False)
    further = room.room.maps.refinement
    assert further is not None
    b = rng.uniform(size=(*CAMERA, 3))
    found = PreparedRows(further.direct).apply(b).reshape(-1, 3)
    luminance = np.tensordot([0.2126, 0.7152, 0.0722], np.where(room.inside[:, None], room.dense, 0), 1)
    for pixel in range(found.shape[0]):
        asked = int(luminance[:, pixel].argmax())
        expected = 0.0 if pixel == DARK else b.reshape(-1, 3)[asked] / room.dense[:, asked].sum(axis=1)
        np.testing.assert_allclose(found[pixel], expected, rtol=1e-5)  # rounding to float32


@pytest.mark.parametrize("start", STARTS)
@pytest.mark.parametrize("far", [False, True])
@pytest.mark.parametrize("bounded", [True, False])
def test_many_steps_reach_scipys_bounded_least_squares(
    rng: np.random.Generator, far: bool, start: str, bounded: bool
) -> None:
    room, frame = physical_room(rng, far=far), desired(rng)
    room, b = (room, light(room, frame)) if bounded else (unbounded(room), asked(room, frame))
    drive, certificate = refined(room, frame, 600, start)
    best = best_errors(room, b)
    assert drive.min() == 0
    assert drive.max() == 1
    assert np.all(drive[DARK] == 0)
    np.testing.assert_allclose(squared_errors(room, drive, b), best, rtol=1e-4)  # T in float32, 600 steps
    assert bounded or certificate.decibels < 0.01  # the certificate refers to the unlimited target


def test_steps_lead_downhill_and_the_certificate_holds_on_the_way(rng: np.random.Generator) -> None:
    room, frame = unbounded(physical_room(rng)), desired(rng)
    b = asked(room, frame)
    best = best_errors(room, b)
    errors = []
    for steps in (0, 1, 2, 4, 8, 16, 32, 64):
        drive, certificate = refined(room, frame, steps)
        found = squared_errors(room, drive, b)
        np.testing.assert_allclose(certificate.squared_error, found, rtol=1e-4)  # T in float32
        assert np.all(found - best <= 2 * certificate.gap * (1 + 1e-6))
        assert 10 * np.log10(found.sum() / best.sum()) <= certificate.decibels
        errors.append(found.sum())
    assert errors == sorted(errors, reverse=True)
    assert errors[0] > 1.05 * errors[-1]  # the clamped T⁺ is not the optimum, so refinement can improve it


def test_the_certificate_of_any_drive_is_a_bound(rng: np.random.Generator) -> None:
    """E* ≥ Σ (E − G)²/E holds for any p, not only near the optimum."""
    T, b = rng.uniform(size=(30, 12)), rng.uniform(0, 4, 30)
    best = 2 * lsq_linear(T, b, (0, 1), method="bvls").cost
    for drive in rng.uniform(size=(200, 12)).round(rng.integers(0, 3)):
        residual = T @ drive - b
        gradient = T.T @ residual
        error, gap = residual @ residual, np.maximum(gradient * drive, gradient * (drive - 1)).sum()
        certificate = Certificate(np.array([error]), np.array([gap]))
        assert (error - best) / 2 <= gap
        assert 10 * np.log10(error / best) <= certificate.decibels
        assert certificate.relative == pytest.approx(2 * gap / error)


def test_what_a_map_takes_is_counted_in_steps() -> None:
    """With one entry per row in T and its transpose, a step reads as many bytes as T⁺ with two entries per row."""
    side, pixels = 12, 144
    one = pack_matrices([sparse.eye_array(pixels, format="csr")] * 3, (side, side), (side, side))
    far = Chain(one, one, one)
    for entries in (9, 10):
        many = sparse.csr_array(np.tile(np.arange(pixels) < entries, (pixels, 1)).astype(np.float32))
        correction = pack_matrices([many] * 3, (side, side), (side, side))
        step_size = np.ones((side, side, 3), np.float32)
        further = RefinementMaps(one, None, one, step_size, Prior.none((side, side)), *[step_size[..., 0]] * 2)
        near = RoomMaps(correction, one, None, None, 0.5, refinement=further)
        assert near.correction_in_steps == entries / 2
        both = RoomMaps(correction, one, far, far, 0.5, refinement=replace(further, far_dual=far))
        assert both.correction_in_steps == (entries + 3) / (2 + 6)
        assert replace(near, refinement=None).correction_in_steps == 0


def test_a_certificate_that_says_nothing_says_so() -> None:
    empty = Certificate(np.zeros(3), np.zeros(3))
    useless = Certificate(np.ones(3), np.full(3, 2.0))
    assert useless.to_dict() == {"relative_gap": 4.0, "certified_db": None, "light_outside": None}
    assert "no bound" in str(useless)
    assert empty.relative == 0


def test_every_unclamped_mode_decays() -> None:
    """An eigenvalue λ of s TᵀT follows y⁺ = ((1+β)(1−λ) − γλ) y − β(1−λ) y⁻: both roots inside the unit circle."""
    for beta in {momentum(step) for step in range(1, 100)}:
        for eigenvalue in np.linspace(1e-6, 1, 500):
            kept = 1 - eigenvalue
            roots = np.roots([1, -((1 + beta) * kept - OVER_RELAXATION * eigenvalue), beta * kept])
            assert np.abs(roots).max() < 1
    assert momentum(10_000) == LARGEST_MOMENTUM < 1


def test_the_next_frame_goes_on_where_the_last_one_ended(rng: np.random.Generator) -> None:
    room, first, second = physical_room(rng), desired(rng), desired(rng)
    renderer = CpuRenderer(room.room)
    renderer.open(first.format)

    def show(frame: Frame) -> np.ndarray:
        renderer.upload(frame)
        renderer.render("projector", compensate=True, steps=3)
        return renderer.linear().reshape(-1, 3).astype(float)

    errors = [squared_errors(room, show(first), light(room, first)).sum() for _ in range(4)]
    assert errors == sorted(errors, reverse=True)
    assert errors[3] < errors[0]
    np.testing.assert_allclose(show(second), refined(room, second, 3)[0], atol=1e-7)  # a cut: nothing is carried over


def test_cuts_are_found_and_motion_is_none(rng: np.random.Generator) -> None:
    scene, other = (np.kron(rng.integers(0, 255, (9, 12, 1)), np.ones((16, 16, 3))).astype(np.uint8) for _ in range(2))
    brighter = np.minimum(scene.astype(int) + int(200 * CUT), 255).astype(np.uint8)
    cuts = SceneCuts()
    shown = [scene, scene, np.roll(scene, 1, axis=1), brighter, other, other]
    assert [cuts.starts_with(rgb_frame(picture)) for picture in shown] == [True, False, False, False, True, False]


@pytest.mark.parametrize(("base_s", "step_s"), [(0.002, 0.001), (0.02, 0.002), (0.001, 0.012), (0.05, 0.001)])
def test_a_budget_fills_the_frame_and_keeps_it(base_s: float, step_s: float) -> None:
    interval_s = 0.04
    budget = StepBudget(interval_s)
    times = []
    for _ in range(1000):
        times.append(base_s + step_s * budget.steps)
        budget.took(times[-1])
    late = [time_s for time_s in times[10:] if time_s > interval_s]
    if base_s > SHARE_OF_FRAME * interval_s:
        assert budget.steps <= 1
    else:
        assert len(late) <= 10  # one attempt per hundred frames
        assert np.median(times) > (SHARE_OF_FRAME - 0.25) * interval_s - step_s


def test_a_budget_gives_what_is_usual_where_there_is_time_and_never_more() -> None:
    budget, counts = StepBudget(0.04, most=8), []
    for base_s in [0.0] * 20 + [0.02] * 20 + [0.0] * 200:  # other load appears and ends
        budget.took(base_s + 0.003 * budget.steps)
        counts.append(budget.steps)
    assert set(counts[:20]) == {8}
    assert counts[39] == 4
    assert counts[-1] == 8 == max(counts)


def test_maps_without_refinement_and_with(tmp_path: Path) -> None:
    folder = tmp_path / "room"
    write_blurred_room(folder, np.random.default_rng(3), (9, 14), (6, 8))
    stored = calibration.read(folder)
    build_room_maps(stored, InverseOptions(0.1), refine=False)
    assert maps.read_maps(stored).refinement is None
    built = build_room_maps(stored, InverseOptions(0.1)).maps.refinement
    read = maps.read_maps(stored).refinement
    assert built is not None
    assert read is not None
    np.testing.assert_array_equal(read.step_size, built.step_size)
    np.testing.assert_array_equal(read.dual.entries, built.dual.entries)
    np.testing.assert_array_equal(read.direct.lookup, built.direct.lookup)
    assert maps.read_maps(stored, refinement=False).refinement is None

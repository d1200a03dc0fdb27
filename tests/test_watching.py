"""Changes of a rig's room during a film are found and corrected; other events are only reported."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy import sparse

from counterlight.calibration import Calibration, Device
from counterlight.passes.encode import encoded
from counterlight.pipeline.drift import Moved
from counterlight.response import Response
from counterlight.tools.acquisition.cameras.camera import Exposures
from counterlight.tools.acquisition.registration import random_field
from counterlight.tools.colour.tiers import tier_of
from counterlight.tools.transport.transport import Transport
from counterlight.tools.watching import watcher
from counterlight.tools.watching.estimate import COARSE, SETTLE_S, Estimate, information
from counterlight.tools.watching.evidence import Compared, Evidence, Layout
from counterlight.tools.watching.learning import PART_S, PARTS
from counterlight.tools.watching.view import RoomView, regional
from counterlight.unattended.watch_link import GRID, Answer, Light, Picture
from tests.oracles.formulas import grid_means
from tests.rig.projector import Projector
from tests.rig.rays import FloatArray
from tests.rig.rig import Devices, Rig
from tests.rig.rooms import ROOMS
from tests.rig.watching import WatchCamera, dust, since
from tests.watched_films import FRAMES_PER_S, Film, Scene, watched

SCALE, CHANGE_S, END_S = 0.4, 8.0, 19.0
CALM = Devices(projector=Projector(gammas=None))
NEAR_PX, NEAR_LIGHT = 0.06, 0.015  # a film of 11 s after the change; 64x48 camera pixels of 8 bits
RARELY_S = 6.0  # between captures that teach the same in less processor time
STILL_PX = 0.02  # noise of the picture's middle, if nothing has moved


@pytest.fixture(scope="module")
def rig() -> Rig:
    return Rig(ROOMS["wall"](SCALE), CALM)


@pytest.fixture(scope="module")
def view(rig: Rig) -> RoomView:
    """The true room, as a calibration without errors: each channel of the camera sees one primary."""
    (height, width), (rows, columns) = rig.camera, rig.raster
    near = sparse.csr_array(rig.transport.near)
    camera, projector = height * width, rows * columns
    matrices = [
        sparse.csr_array(near[k * camera : (k + 1) * camera, k * projector : (k + 1) * projector]) for k in range(3)
    ]
    transport = Transport.from_matrices(matrices, camera=rig.camera, projector=rig.raster)
    black = rig.seen(np.zeros((rows, columns, 3), np.uint8)).reshape(height, width, 3).astype(np.float32)
    flood = transport.composition().reshape(black.shape)
    mask = (flood > 0.05 * flood.max()).all(axis=2)
    device = Device(rows, columns, Response("srgb"))
    room = Calibration("rig", "", (device,), Device(height, width, Response("linear")), black, mask)
    return RoomView(tier_of(room, transport), 1)


def film(rig: Rig) -> Film:
    """Returns pictures of random fields, each for half a second, then faded into the next one."""
    rng = np.random.default_rng(3)
    pictures = [
        np.stack([random_field(rig.raster, 3 * number + k) for k in range(3)], axis=2) * rng.uniform(0.5, 0.9, 3)
        for number in range(12)
    ]

    def at(time_s: float) -> FloatArray:
        number, share = divmod(time_s, 1.5)
        one, other = (pictures[int(number + i) % len(pictures)] for i in range(2))
        fade = np.clip(share - 0.5, 0, 1)
        return np.asarray((1 - fade) * one + fade * other)

    return at


def seen(view: RoomView, rig: Rig, scene: Scene, end_s: float = END_S) -> list[Answer]:
    return [moment.answer for moment in watched(view, rig, film(rig), scene, end_s)]


def panned(rig: Rig) -> Film:
    """Returns a random field that moves to the right by a pixel per frame, and changes every two seconds."""
    fields = [np.stack([random_field(rig.raster, 3 * number + k) for k in range(3)], axis=2) for number in range(3)]

    def at(time_s: float) -> FloatArray:
        number, since_s = divmod(time_s, 2)
        return np.asarray(0.8 * np.roll(fields[int(number) % len(fields)], int(since_s * FRAMES_PER_S), axis=1))

    return at


def later(**changes: object) -> Scene:
    """Returns a scene whose devices change at CHANGE_S."""
    return Scene(partial(since(CHANGE_S, **changes), CALM))


def middle(view: RoomView, answer: Answer) -> FloatArray:
    """Returns the displacement of the picture's middle, projector pixels."""
    each = answer.projectors[0]
    moved = Moved(np.array(each.to_raster), np.array(each.gain))
    return np.asarray(moved.at_corners(view.room.projectors[0])[0])


def compared_by(H: FloatArray, truth: FloatArray, coarse: float = 0.0) -> Compared:
    """Returns a capture whose evidence is H around the true θ."""
    evidence = Evidence(H, H @ truth, 0.5 * truth @ H @ truth, 1.0)
    return Compared(evidence, 1.0, 0.0, 1.0, 1.0, coarse, 1.0, np.zeros((1, 3)), np.ones((1, 3)))


def test_the_light_of_regions_is_predicted_from_a_grid(view: RoomView, rng: np.random.Generator) -> None:
    """The prediction is exact for a picture that is even in each cell."""
    edges = [np.arange(cells + 1) * size // cells for size, cells in zip(view.raster, GRID, strict=True)]
    rows, columns = (np.repeat(np.arange(len(each) - 1), np.diff(each)) for each in edges)
    picture = rng.random((*GRID, 3))[rows][:, columns]
    coarse, region = view.coarse
    found = np.einsum("krc,ck->rk", coarse, grid_means(picture).reshape(-1, 3))
    expected = np.stack([regional(each, region) for each in view.seen(picture).T], axis=1)
    np.testing.assert_allclose(found, expected, atol=1e-6)


@pytest.mark.parametrize("shift", [(0.3, 0.4), (-2.0, 1.0)])
def test_a_jump_of_the_picture_is_found(view: RoomView, rig: Rig, shift: tuple[float, float]) -> None:
    answers = seen(view, rig, later(shift=shift))
    np.testing.assert_allclose(middle(view, answers[-1]), shift, atol=NEAR_PX)
    np.testing.assert_allclose(answers[-1].projectors[0].gain, 1, atol=NEAR_LIGHT)
    before = [middle(view, answer) for answer in answers[: int(2 * CHANGE_S) - 2]]
    assert np.abs(before).max() < STILL_PX


@pytest.mark.parametrize("exposure_s", [0.002, 1 / 60, 1 / 24])
def test_a_jump_is_found_by_a_camera_of_unknown_exposure(view: RoomView, rig: Rig, exposure_s: float) -> None:
    camera = WatchCamera(period_s=0.1, exposure_s=exposure_s)
    scene = replace(later(shift=(0.3, 0.4)), camera=camera, told=False)
    last = seen(view, rig, scene)[-1]
    np.testing.assert_allclose(middle(view, last), (0.3, 0.4), atol=NEAR_PX)
    expected_s = camera.latency_s + 0.8 * camera.jitter_s + camera.rolling_s / 2  # latency of the middle row
    assert abs(last.latency_s - expected_s) < exposure_s / 2 + 0.01  # the exposures that are tried lie this far apart


def test_a_lamp_that_dims_is_found(view: RoomView, rig: Rig) -> None:
    last = seen(view, rig, later(projector=replace(CALM.projector, lamp=0.9)))[-1]
    np.testing.assert_allclose(last.projectors[0].gain, 0.9, atol=NEAR_LIGHT)
    assert np.abs(middle(view, last)).max() < STILL_PX


@pytest.mark.parametrize(("after_s", "found"), [(5, 0.88), (SETTLE_S + 5, 0.91)])
def test_the_first_estimate_is_improved_soon_after_a_change(after_s: float, found: float) -> None:
    """Rounded code values hide changes below 3.6 %, except soon after a change."""
    layout = Layout(1)
    estimate, truth, first = Estimate(layout, 1.0), np.zeros(layout.size), np.zeros(layout.size)
    truth[layout.gain(0)], first[layout.gain(0)] = -0.12, -0.09
    H = np.diag(np.where(np.isin(np.arange(layout.size), layout.gain(0)), 1e7, 0.0))
    compared = compared_by(H, truth, coarse=0.036 / COARSE)
    estimate.add(0.0, compared, np.inf)
    estimate.apply(first)
    for number in range(6):
        estimate.add(after_s + number / 2, compared, np.inf)
    best = estimate.find()
    assert best is not None
    np.testing.assert_allclose(1 + best.theta[layout.gain(0)], found, atol=1e-6)  # a diagonal system in float64


def test_a_wrong_correction_does_not_hide_a_moved_camera() -> None:
    """A moved camera moves the picture and the wall's texture in its captures; only the picture has been corrected."""
    layout = Layout(1)
    estimate, truth, wrong = Estimate(layout, 1.0), np.zeros(layout.size), np.zeros(layout.size)
    projector, camera = layout.geometry(0)[0], layout.camera[0]
    truth[camera], truth[projector], wrong[projector] = 1, 0.9, 0.9
    information_by = np.zeros(layout.size)
    information_by[projector], information_by[layout.camera] = 1e5, 4e4
    compared = compared_by(np.diag(information_by), truth)
    for number in range(12):
        estimate.add(number / 2, compared, np.inf)
        if number == 5:
            estimate.apply(wrong)
    found = estimate.find()
    assert found is not None
    assert (found.texture, found.which) == (True, 0)
    # four captures are held back
    np.testing.assert_allclose(found.camera, 4 * information(np.inf) * 4e4 / 2, rtol=0.05)


def test_the_light_of_the_room_is_found(view: RoomView, rig: Rig) -> None:
    last = seen(view, rig, later(room_light=3 * CALM.room_light))[-1]
    added = 2 * rig.ambient
    paint = view.paint.reshape(-1, 3)[view.room.mask.ravel()].astype(np.float64)
    found = np.mean(last.ambient, axis=(0, 1))
    expected = (added[view.room.mask.ravel()] * paint).sum(axis=0) / (paint**2).sum(axis=0)
    np.testing.assert_allclose(found, expected, rtol=0.1)  # a field of twelve cells, clipped texture
    assert np.abs(middle(view, last)).max() < STILL_PX


def passing(time_s: float) -> FloatArray:
    """Returns a dark person of a quarter of the view, who walks to the right."""
    share, left = np.ones((48, 64)), int(2 * (time_s - CHANGE_S))
    share[:, max(left, 0) : max(left + 16, 0)] = 0.3
    return share


@pytest.mark.parametrize("person", [False, True])
def test_nothing_is_corrected_when_nothing_has_changed(view: RoomView, rig: Rig, person: bool) -> None:
    scene = Scene(lambda _: CALM, passing) if person else Scene(lambda _: CALM)
    for answer in seen(view, rig, scene):
        assert np.abs(middle(view, answer)).max() < STILL_PX
        np.testing.assert_allclose(answer.projectors[0].gain, 1, atol=NEAR_LIGHT)


def test_a_panning_film_is_no_movement(view: RoomView, rig: Rig) -> None:
    """Captures arrive with 12 ms of jitter, in which the film moves by 0.3 pixels."""
    scene = Scene(lambda _: CALM, camera=WatchCamera(period_s=0.2, jitter_s=0.012), told=False)
    answers = [moment.answer for moment in watched(view, rig, panned(rig), scene, END_S)]
    assert {answer.state for answer in answers} <= {"looking", "holding", "correcting"}
    assert np.abs([middle(view, answer) for answer in answers]).max() < STILL_PX
    assert answers[-1].captures > 20


@pytest.mark.parametrize(
    ("scene", "state", "said"),
    [
        (later(camera_moved=(3, 2)), "camera moved", "put it back"),
        (Scene(lambda _: CALM, camera=WatchCamera(automatic=True)), "camera changed", "exposure"),
        (Scene(lambda _: CALM, frozen_s=CHANGE_S), "no camera", "repeats one picture"),
    ],
)
def test_a_camera_that_changes_is_reported_and_nothing_corrected(
    view: RoomView, rig: Rig, scene: Scene, state: str, said: str
) -> None:
    last = seen(view, rig, scene, CHANGE_S + 10)[-1]
    assert (last.state, said in last.reason) == (state, True)
    assert np.abs(middle(view, last)).max() < STILL_PX


def test_only_a_camera_that_is_waited_for_is_silent(view: RoomView) -> None:
    """A capture that takes long to compare is not the camera's silence."""
    watching = watcher.Watcher(view, 1e-4, 1 / 60)
    watching.arrived(1.0)
    assert watching.answer(60.0).state == "looking"
    watching.waits(60.0)
    answers = [watching.answer(time_s) for time_s in (62.0, 64.0)]
    watching.arrived(64.5)
    answers.append(watching.answer(65.0))
    assert [each.state for each in answers] == ["looking", "no camera", "looking"]
    assert answers[1].reason == "no capture for 4 s"


def test_dust_is_learned_within_minutes_and_forgotten_if_the_camera_moves_meanwhile(
    view: RoomView, rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The camera sees a picture of the film now and then: a soft spot reflects 80 %, then the camera moves.

    The last twenty answers are undone, which are ten seconds in a show.
    """
    monkeypatch.setattr(watcher, "LEARNED_PER_S", 1.0)
    watching, shown, rng = watcher.Watcher(view, 1e-4, 1 / 60, follows=True), film(rig), np.random.default_rng(4)
    wall, moved_s = dust(0.0, rig.camera), (PARTS + 1.5) * PART_S
    away, exposures = rig.after(replace(CALM, camera_moved=(3, 2))), Exposures((1.0,), view.room.camera.response)
    assert wall is not None
    for time_s in np.arange(0, moved_s + 20, RARELY_S):
        rich = np.clip(2 * shown(1.5 * time_s / RARELY_S) - 0.4, 0.02, 0.9)
        codes = encoded(rich, view.room.response)
        drive = view.room.response.to_linear(codes).astype(np.float16)
        watching.light(Light(time_s, grid_means(drive)))
        watching.picture(Picture(time_s, drive))
        light = rig.seen(codes) if time_s < moved_s else away.seen_by_camera(codes)
        shot = rig.devices.sensor.codes(light.reshape(*rig.camera, 3) * wall[..., None], rig.light.weakness, rng)
        watching.capture(time_s + 0.01, np.rint(shot / 257.0).astype(np.uint8), exposures)
        answer = watching.answer(time_s + 0.02)
        if time_s < moved_s:
            before, learned = answer, watching.row_gains()
    assert (before.state, before.reason.partition("%")[2]) == ("holding", " of the view has become darker")
    left, was = (np.square(each - wall[..., None])[view.counted.reshape(view.shape)] for each in (learned, 1.0))
    assert left.mean() < 0.1 * was.mean()  # a few captures leave some blocks unknown
    assert np.mean(learned[wall > 0.995] == 1) > 0.9
    assert (before.row_gains > 0, answer.state, answer.row_gains) == (True, "camera moved", 0)
    following = watcher.Watcher(view, 1e-4, 1 / 60, row_gains=learned)  # after a fault
    assert following.answer(0.0).row_gains > 0
    np.testing.assert_array_equal(following.row_gains(), learned)

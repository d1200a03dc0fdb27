"""Refinement on the GPU against the CPU function: each shader, the iteration, the certificate, state between frames."""

from dataclasses import replace

import moderngl
import numpy as np
import pytest

from counterlight.gl.passes import Canvas, Programs, float_texture, picture_texture
from counterlight.maps.prior import Prior
from counterlight.media.frames import radiance_frame
from counterlight.media.video import Frame
from counterlight.passes.certificate import BlockSum, Gap, Weighted, block_sum
from counterlight.passes.combine import Combine
from counterlight.passes.refinement_step import Slope, Step, Ties
from counterlight.pipeline.cpu_renderer import CpuCanvas
from counterlight.pipeline.refinement import STARTS, Certificate
from counterlight.pipeline.room import Room
from tests.oracles import formulas
from tests.refined_rooms import physical_room
from tests.renderers import both, on_gpu, read
from tests.rooms import CAMERA, random_room, rgb_frame

ATOL = 1e-5  # the tolerance that the product promises
SHAPE = (37, 21)


def pictures(rng: np.random.Generator, *names: str) -> dict[str, np.ndarray]:
    return {name: rng.uniform(-1, 2, (*SHAPE, 3)).astype(np.float32) for name in names}


def test_combine_matches_the_reference(gl_context: moderngl.Context, rng: np.random.Generator) -> None:
    inputs = pictures(rng, "first", "second")
    for clamp in (False, True):
        made = Combine(*inputs.values(), -0.75, clamp)
        result = on_gpu(gl_context, made, SHAPE)
        for expected in (formulas.combine(made.first, made.second, -0.75, clamp=clamp), CpuCanvas(SHAPE).draw(made)):
            np.testing.assert_allclose(result, expected, atol=1e-6)  # rounding to float32


def test_a_step_matches_the_reference(gl_context: moderngl.Context, rng: np.random.Generator) -> None:
    inputs = pictures(rng, "descent", "y", "p", "step_size")
    prior = a_prior(rng)
    inputs["step_size"] = np.where(rng.uniform(size=(*SHAPE, 3)) < 0.3, 0, np.abs(inputs["step_size"]))
    expected = formulas.refinement_step(*(inputs[name] for name in ("descent", "y", "p", "step_size")), prior, 0.7, 0.6)
    assert all(0 < np.mean(expected[0] == bound) < 0.9 for bound in (0, 1))
    textures, ties = (
        {name: picture_texture(gl_context, picture) for name, picture in group.items()}
        for group in (inputs, vars(prior))
    )
    programs = Programs(gl_context)
    canvas = Canvas(gl_context, programs, *(float_texture(gl_context, SHAPE) for _ in range(2)))
    canvas.draw(Step(**textures, prior=Ties(**ties), momentum=0.7, over_relaxation=0.6))
    results = [read(picture) for picture in canvas.pictures]
    for resource in (canvas, programs, *textures.values(), *ties.values()):
        resource.release()
    compiled = [np.zeros((*SHAPE, 3), np.float32) for _ in range(2)]
    Step(**inputs, prior=Ties(**vars(prior)), momentum=0.7, over_relaxation=0.6).fill_both(*compiled, draws=True)
    for result, cpu, formula in zip(results, compiled, expected, strict=True):
        np.testing.assert_allclose(result, formula, atol=1e-5)  # float32, sums of terms up to 15
        np.testing.assert_allclose(cpu, formula, atol=1e-5)


def test_the_gap_and_the_error_match_the_reference(gl_context: moderngl.Context, rng: np.random.Generator) -> None:
    inputs = pictures(rng, "descent", "p")
    inputs["p"] = np.clip(inputs["p"], 0, 1)
    result = on_gpu(gl_context, Gap(**inputs), SHAPE)
    np.testing.assert_allclose(result, CpuCanvas(SHAPE).draw(Gap(**inputs)), atol=1e-6)  # rounding to float32
    assert result.min() >= 0
    weighed = pictures(rng, "picture", "weights")
    for squared in (False, True):
        made = Weighted(**weighed, squared=squared)
        result = on_gpu(gl_context, made, SHAPE)
        np.testing.assert_allclose(result, CpuCanvas(SHAPE).draw(made), atol=4e-6)  # float32, up to 8


def test_the_slope_beside_a_prior_matches_the_reference(gl_context: moderngl.Context, rng: np.random.Generator) -> None:
    inputs, prior = pictures(rng, "descent", "y"), a_prior(rng)
    made = Slope(**inputs, prior=Ties(**vars(prior)))
    result = on_gpu(gl_context, made, SHAPE)
    np.testing.assert_allclose(result, CpuCanvas(SHAPE).draw(made), atol=1e-5)  # float32, terms up to 15


@pytest.mark.parametrize("steps", [0, 3])
def test_what_the_room_alone_makes_too_bright_is_reported_and_not_asked_for(
    gl_context: moderngl.Context, rng: np.random.Generator, steps: int
) -> None:
    room = physical_room(rng).room
    lamp = np.where(rng.uniform(size=(*CAMERA, 1)) < 0.3, 0.2, room.calibration.ambient).astype(np.float32)
    room = replace(room, calibration=replace(room.calibration, ambient=lamp))
    picture = 0.4 * rng.uniform(size=(*CAMERA, 3)).astype(np.float32)
    for index in range(2):  # on the GPU, and on the CPU
        shown = [seen(gl_context, room, each, steps)[index] for each in (picture, np.maximum(picture, lamp))]
        (drive, error, certificate), (possible, exact, measured) = shown
        np.testing.assert_array_equal(drive, possible)
        assert (error != exact).any()
        assert np.all(certificate.squared_error > measured.squared_error)


def seen(
    context: moderngl.Context, room: Room, picture: np.ndarray, steps: int
) -> list[tuple[np.ndarray, np.ndarray, Certificate]]:
    """Return each renderer's drive, error map and certificate of a radiance picture."""
    found = []
    with both(context, room, radiance_frame(picture)) as renderers:
        for renderer in renderers:
            renderer.render("error", compensate=True, steps=steps)
            error = renderer.linear()
            renderer.render("projector", compensate=True, steps=steps)
            certificate = renderer.certificate()
            assert certificate is not None
            found.append((renderer.linear(), error, certificate))
    return found


@pytest.mark.parametrize("side", [2, 5, 16, 64])
def test_a_block_sum_matches_the_reference(gl_context: moderngl.Context, rng: np.random.Generator, side: int) -> None:
    inputs = pictures(rng, "source")
    shape = -(-SHAPE[0] // side), -(-SHAPE[1] // side)
    result = on_gpu(gl_context, BlockSum(inputs["source"], side), shape)
    expected = block_sum(inputs["source"].astype(float), side)
    np.testing.assert_allclose(result, expected, atol=1e-3)  # float32 sums of up to 777 terms
    np.testing.assert_allclose(expected.sum(axis=(0, 1)), inputs["source"].sum(axis=(0, 1), dtype=float))


def a_prior(rng: np.random.Generator) -> Prior:
    """Return a random prior without ties across the picture's edge."""
    prior = Prior(*(rng.uniform(0, 1, (*SHAPE, 3)).astype(np.float32) for _ in range(3)))
    prior.right[:, -1] = prior.down[-1] = 0
    return prior


def letters(rng: np.random.Generator) -> Frame:
    return radiance_frame(rng.choice([0.02, 0.3, 0.9], (*CAMERA, 3)).astype(np.float32))


@pytest.mark.parametrize("start", STARTS)
@pytest.mark.parametrize("far", [False, True])
def test_the_drive_matches_the_reference_after_any_steps(
    gl_context: moderngl.Context, rng: np.random.Generator, far: bool, start: str
) -> None:
    room, frame = physical_room(rng, far=far, start=start).room, letters(rng)
    for steps in (0, 1, 5, 50):
        with both(gl_context, room, frame) as (gl, cpu):
            for renderer in (gl, cpu):
                renderer.render("projector", compensate=True, steps=steps)
            assert gl.linear().std() > 0.05
            np.testing.assert_allclose(gl.linear(), cpu.linear(), atol=ATOL)
            found, expected = gl.certificate(), cpu.certificate()
            assert found is not None
            assert expected is not None
            np.testing.assert_allclose(found.squared_error, expected.squared_error, rtol=1e-4)  # rounding to float32
            scale = expected.squared_error.sum()
            # the parts of g nearly cancel
            np.testing.assert_allclose(found.gap, expected.gap, rtol=1e-4, atol=1e-5 * scale)


@pytest.mark.parametrize("steps", [0, 3])
def test_what_is_read_back_for_an_estimate_matches_the_reference(
    gl_context: moderngl.Context, rng: np.random.Generator, steps: int
) -> None:
    with both(gl_context, physical_room(rng).room, letters(rng)) as (gl, cpu):
        for renderer in (gl, cpu):
            renderer.render("projector", compensate=True, steps=steps, timed=True)
            assert {"linear", "place", "start", "view", "encode"} <= renderer.stage_s.keys()
            assert ("steps" in renderer.stage_s) == (steps > 0)
        found, expected = gl.snapshot(), cpu.snapshot()
        assert found is not None
        assert expected is not None
        assert (found.made, found.steps) == (expected.made, expected.steps) == (steps, steps)
        for name in ("drive", "ahead", "descent"):
            np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=ATOL)
        certificate = gl.certificate()
        assert certificate is not None
        np.testing.assert_array_equal(found.certificate.gap, certificate.gap)


def test_another_start_begins_with_the_next_frame(gl_context: moderngl.Context, rng: np.random.Generator) -> None:
    physical, frame = physical_room(rng), letters(rng)
    with (
        both(gl_context, replace(physical.room, start="direct"), frame) as meant,
        both(gl_context, physical.room, frame) as switched,
    ):
        for (of_start, _), (renderer, _) in ((meant, switched), (meant[::-1], switched[::-1])):
            of_start.render("projector", compensate=True, steps=2)
            renderer.render("projector", compensate=True, steps=2)
            assert np.abs(renderer.linear() - of_start.linear()).max() > 1e-3
            renderer.start_from("direct")
            renderer.render("projector", compensate=True, steps=2)
            np.testing.assert_array_equal(renderer.linear(), of_start.linear())


@pytest.mark.parametrize("start", ["previous", "previous-direct"])
def test_frames_in_a_row_match_the_reference(
    gl_context: moderngl.Context, rng: np.random.Generator, start: str
) -> None:
    """Two similar frames, a cut, a frame without refinement, and another frame."""
    scene, other = (rng.integers(0, 255, (*CAMERA, 3)).astype(np.uint8) for _ in range(2))
    darker = (scene * 0.95).astype(np.uint8)
    shown = [(scene, 3), (darker, 3), (darker, 3), (other, 3), (other, 0), (darker, 3)]
    with both(gl_context, physical_room(rng, start=start).room, rgb_frame(scene)) as (gl, cpu):
        drives = []
        for picture, steps in shown:
            for renderer in (gl, cpu):
                renderer.upload(rgb_frame(picture))
                renderer.render("projector", compensate=True, steps=steps)
            np.testing.assert_allclose(gl.linear(), cpu.linear(), atol=ATOL)
            drives.append(gl.linear())
            for renderer in (gl, cpu):  # drawing a frame again changes nothing
                renderer.render("projector", compensate=True, steps=steps)
            np.testing.assert_array_equal(gl.linear(), drives[-1])
            np.testing.assert_allclose(cpu.linear(), drives[-1], atol=ATOL)
    assert np.abs(drives[2] - drives[1]).max() > 1e-3  # uploading the same frame continues refinement
    assert np.abs(drives[5] - drives[1]).max() > 1e-3  # after a frame without refinement, the start is new


def test_steps_go_on_from_frame_to_frame_of_a_still_picture(
    gl_context: moderngl.Context, rng: np.random.Generator
) -> None:
    """Four frames of three steps equal one frame of twelve steps: drive, momentum and schedule carry over."""
    physical, frame = physical_room(rng), letters(rng)
    with both(gl_context, physical.room, frame) as at_once, both(gl_context, physical.room, frame) as in_frames:
        for renderer in at_once:
            renderer.render("projector", compensate=True, steps=12)
        for renderer in in_frames:
            for index in range(4):
                renderer.render("projector", compensate=True, steps=3)
                if index < 3:
                    renderer.upload(frame)
        for twelve, threes in zip(at_once, in_frames, strict=True):
            np.testing.assert_allclose(threes.linear(), twelve.linear(), atol=ATOL)


@pytest.mark.parametrize("view", ["projector", "camera", "split"])
def test_no_step_is_the_thesis_method_bit_for_bit(
    gl_context: moderngl.Context, rng: np.random.Generator, view: str
) -> None:
    room, frame = physical_room(rng).room, letters(rng)
    bare = replace(room, maps=replace(room.maps, refinement=None))
    results = []
    for each in (room, bare):
        with both(gl_context, each, frame) as (gl, _):
            gl.render(view, compensate=True, steps=0)
            results.append((gl.linear().tobytes(), gl.encoded().tobytes()))
    assert results[0] == results[1]


def test_without_a_step_direct_mapping_is_shown_where_it_is_asked_for(
    gl_context: moderngl.Context, rng: np.random.Generator
) -> None:
    physical, frame = physical_room(rng), letters(rng)
    direct = physical.room.maps.refinement.direct
    corrected = replace(physical.room, maps=replace(physical.room.maps, correction=direct, undo=None))
    with both(gl_context, physical.room, frame) as asked, both(gl_context, corrected, frame) as meant:
        for renderer, expected in zip(asked, meant, strict=True):
            renderer.start_from("previous-direct", "direct")
            for each in (renderer, expected):
                each.render("projector", compensate=True, steps=0)
            np.testing.assert_array_equal(renderer.linear(), expected.linear())
            renderer.start_from("previous-direct")
            renderer.render("projector", compensate=True, steps=0)
            assert np.abs(renderer.linear() - expected.linear()).max() > 1e-3


def test_without_the_maps_there_are_no_steps_and_no_certificate(
    gl_context: moderngl.Context, rng: np.random.Generator
) -> None:
    with both(gl_context, random_room(rng, far=False), letters(rng)) as renderers:
        for renderer in renderers:
            renderer.render("projector", compensate=True)
            plain = renderer.linear().copy()
            renderer.render("projector", compensate=True, steps=8)
            np.testing.assert_array_equal(renderer.linear(), plain)
            assert renderer.certificate() is None
    with both(gl_context, physical_room(rng).room, letters(rng)) as renderers:
        for renderer in renderers:
            renderer.render("projector", compensate=False)
            assert renderer.certificate() is None


def test_the_camera_sees_less_error_with_every_step(gl_context: moderngl.Context, rng: np.random.Generator) -> None:
    physical, frame = physical_room(rng, start="map"), letters(rng)
    inside = physical.inside
    with both(gl_context, physical.room, frame) as (gl, _):
        errors = []
        for steps in (0, 1, 4, 16):
            gl.render("camera", compensate=True, steps=steps)
            errors.append(np.mean((gl.linear() - gl.desired()).reshape(-1, 3)[inside] ** 2))
    assert errors == sorted(errors, reverse=True)
    assert errors[3] < 0.97 * errors[0]


def test_steps_allocate_nothing(gl_context: moderngl.Context, rng: np.random.Generator) -> None:
    frame = letters(rng)
    with both(gl_context, physical_room(rng).room, frame) as (gl, _):
        gl.render("split", compensate=True, steps=2)
        before = len(gl_context.objects)
        for index in range(30):
            gl.upload(frame)
            gl.render("split", compensate=True, frame=index, steps=index % 5)
            gl.certificate()
        assert len(gl_context.objects) == before

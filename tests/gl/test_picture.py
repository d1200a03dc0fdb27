"""Viewer controls on the GPU against the CPU function. A picture without changes stays bit-identical."""

from dataclasses import replace
from pathlib import Path

import moderngl
import numpy as np
import pytest

from counterlight.files.cube import read_cube
from counterlight.gl import shaders
from counterlight.gl.device import GlDevice
from counterlight.gl.gpu_maps import MapTextures
from counterlight.gl.passes import ShaderPass, float_texture, picture_texture, table_texture
from counterlight.gl.planes import Planes
from counterlight.gl.renderer import GlRenderer
from counterlight.media.frames import radiance_frame
from counterlight.media.video import Frame
from counterlight.passes.adaptation import Limits
from counterlight.passes.colour import decoding_of
from counterlight.passes.reach import Reach
from counterlight.pipeline.adjustments import NEUTRAL, Adjustments
from counterlight.pipeline.content import approach
from counterlight.pipeline.cpu_renderer import CpuCanvas
from counterlight.pipeline.fitting import Fitter
from counterlight.pipeline.test_cards import CARDS, card
from counterlight.pipeline.views import VIEWS
from tests.cubes import UNIT, write_cube
from tests.gl_objects import live_objects
from tests.oracles import adaptation
from tests.refined_rooms import physical_room
from tests.renderers import both, read
from tests.rooms import CAMERA, PROJECTOR, random_room, rgb_frame, yuv_frame
from tests.screens_of_cameras import split_screen

ATOL = 1e-5  # the tolerance that the product promises
PINNED = ((0.1, 0.15), (0.85, 0.05), (0.95, 0.9), (0.2, 0.8))
PICTURES = {
    "brightness": Adjustments(brightness=23),
    "contrast": Adjustments(contrast=-37),
    "gamma": Adjustments(gamma=40),
    "saturation": Adjustments(saturation=80),
    "grey": Adjustments(saturation=-100, brightness=-10, contrast=50, gamma=-30),
    "black level": Adjustments(black_level=0.07),
    "adapt": Adjustments(adapt=2),
    "adapt, much": Adjustments(adapt=30, black_level=0.1),
    "flicker": Adjustments(flicker=0.6),
    "pinned": Adjustments(corners=PINNED),
    "mirrored": Adjustments(corners=(PINNED[1], PINNED[0], PINNED[3], PINNED[2]), black_level=0.05),
    "everything": Adjustments(5, 10, -15, 20, 0.03, 4.0, 0.4, corners=PINNED),
}


def scene(rng: np.random.Generator) -> Frame:
    return rgb_frame(rng.integers(0, 255, (9, 15, 3)).astype(np.uint8))


@pytest.mark.parametrize("name", PICTURES)
@pytest.mark.parametrize("far", [False, True])
def test_every_property_matches_the_reference(
    gl_context: moderngl.Context, rng: np.random.Generator, name: str, far: bool
) -> None:
    room = replace(physical_room(rng, far=far).room, white=0.9)  # brighter than many pixels can show
    frame = yuv_frame(rng, (9, 15), full_range=True)
    with both(gl_context, room, frame) as (gl, cpu):
        gl.render("camera", compensate=True)
        unchanged = gl.linear().copy(), gl.desired().copy()
        for renderer in (gl, cpu):
            renderer.adjust(PICTURES[name])
        for view, compensate, steps in (("projector", True, 0), ("projector", False, 0), ("split", True, 3)):
            for renderer in (gl, cpu):
                renderer.render(view, compensate=compensate, steps=steps)
            np.testing.assert_allclose(gl.linear(), cpu.linear(), atol=ATOL)
        np.testing.assert_allclose(gl.desired(), cpu.desired(), atol=ATOL)
        if name != "flicker":  # flicker has no effect on a first frame
            assert np.abs(gl.desired() - unchanged[1]).max() > 1e-3
        for renderer in (gl, cpu):
            renderer.adjust(NEUTRAL)
        gl.render("camera", compensate=True)
        assert gl.linear().tobytes() == unchanged[0].tobytes()
        assert gl.desired().tobytes() == unchanged[1].tobytes()


HDR = Adjustments(hdr_peak=4000, target_peak=100, brightness=5, gamma=-10)
RENDITIONS = NEUTRAL, HDR, Adjustments(tone_mapping="clip"), NEUTRAL


@pytest.mark.parametrize("transfer", ["pq", "hlg", "srgb"])
@pytest.mark.parametrize("layout", ["yuv", "rgb"])
def test_hdr_and_wide_primaries_match_the_reference(
    gl_context: moderngl.Context, rng: np.random.Generator, transfer: str, layout: str
) -> None:
    changes = {"transfer": transfer, "primaries": "bt2020"}
    frame = yuv_frame(rng, (9, 15), matrix="bt2020", depth=10, rotation=90, **changes)
    if layout == "rgb":
        frame = scene(rng)
        frame = replace(frame, format=replace(frame.format, **changes))  # type: ignore[arg-type]
    with both(gl_context, random_room(rng, far=False), frame) as (gl, cpu):
        for adjustments in RENDITIONS:
            for renderer in (gl, cpu):
                renderer.adjust(adjustments)
                renderer.render("camera", compensate=True)
            np.testing.assert_allclose(gl.linear(), cpu.linear(), atol=ATOL)
            np.testing.assert_allclose(gl.desired(), cpu.desired(), atol=ATOL)


@pytest.mark.parametrize("transfer", ["srgb", "pq"])
def test_a_table_matches_the_reference(
    gl_context: moderngl.Context, rng: np.random.Generator, transfer: str, tmp_path: Path
) -> None:
    """Tables are switched on, off and replaced, also by another type.

    Each table is built on first use, and no GL object is left.
    """
    domains = UNIT, ((-0.1, 0.0, 0.1), (1.1, 0.9, 1.0))
    cubes = [read_cube(write_cube(tmp_path / f"{n}.cube", rng, 5 + 12 * n, domains[n])) for n in range(2)]
    frame = yuv_frame(rng, (9, 15), transfer=transfer, primaries="bt2020" if transfer == "pq" else "bt709", depth=10)
    looks = [Adjustments(lut=cubes[0]), Adjustments(lut=cubes[1], brightness=7), NEUTRAL]
    looks += [Adjustments(lut=cubes[0], lut_type="conversion"), NEUTRAL]
    with both(gl_context, random_room(rng, far=False), frame) as (gl, cpu):
        gl.render("camera", compensate=True)
        unchanged, objects = gl.desired().tobytes(), live_counts()
        for look in looks:
            for renderer in (gl, cpu):
                renderer.adjust(look)
                renderer.render("camera", compensate=True)
            np.testing.assert_allclose(gl.linear(), cpu.linear(), atol=ATOL)
            np.testing.assert_allclose(gl.desired(), cpu.desired(), atol=ATOL)
            assert (gl.desired().tobytes() == unchanged) == (look is NEUTRAL)
        assert live_counts() == objects


def live_counts() -> dict[str, int]:
    return {kind: len(names) for kind, names in live_objects().items()}


@pytest.mark.parametrize("name", ["brightness", "black level", "adapt", "adapt, much"])
def test_radiance_matches_the_reference(gl_context: moderngl.Context, rng: np.random.Generator, name: str) -> None:
    frame = radiance_frame(rng.uniform(0, 1.5, (*CAMERA, 3)).astype(np.float32))
    with both(gl_context, physical_room(rng).room, frame) as (gl, cpu):
        plain = gl.desired().copy()
        for renderer in (gl, cpu):
            renderer.adjust(PICTURES[name])
            renderer.render("projector", compensate=True)
        np.testing.assert_allclose(gl.linear(), cpu.linear(), atol=ATOL)
        np.testing.assert_allclose(gl.desired(), cpu.desired(), atol=ATOL)
        # brightness acts on codes, and radiance has none
        assert (gl.desired().tobytes() == plain.tobytes()) == (name == "brightness")


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("clipping", [False, True])
@pytest.mark.parametrize("compensate", [False, True])
def test_every_view_matches_the_reference(
    gl_context: moderngl.Context, rng: np.random.Generator, view: str, clipping: bool, compensate: bool
) -> None:
    physical = physical_room(rng).room
    room = replace(physical, white=1.1)  # brighter than many pixels can show
    with both(gl_context, room, scene(rng)) as (gl, cpu):
        for renderer in (gl, cpu):
            renderer.adjust(Adjustments(clipping=clipping, contrast=30))
            renderer.render(view, compensate=compensate, steps=2)
        # Map colours change by up to 25 times the figures' change; the figures have a float32 error of 5e-7.
        np.testing.assert_allclose(gl.linear(), cpu.linear(), atol=2 * ATOL)
        assert np.abs(gl.encoded().astype(int) - cpu.encoded()).max() <= 1
        mapped = gl.linear().copy()
        gl.adjust(Adjustments(contrast=30))
        gl.render(view, compensate=compensate, steps=2)
        shown = clipping and view != "impossible" and (compensate or view != "projector")
        assert np.any(np.abs(gl.linear() - mapped) > 0.05) == shown


def test_frames_in_a_row_match_the_reference(gl_context: moderngl.Context, rng: np.random.Generator) -> None:
    """Adaptation and damping continue between frames and restart at a cut. A frame drawn again stays the same."""
    first, other = (rng.integers(0, 200, (*CAMERA, 3)).astype(np.uint8) for _ in range(2))
    shown = [first, first // 2 + 60, first // 2 + 60, other, other + 20, other]
    room = replace(physical_room(rng).room, white=0.8)
    picture = Adjustments(adapt=3, flicker=0.7)
    drives = []
    with both(gl_context, room, rgb_frame(first)) as (gl, cpu):
        for index, codes in enumerate(shown):
            for renderer in (gl, cpu):
                renderer.adjust(picture if index < 5 else replace(picture, adapt=6))
                renderer.upload(rgb_frame(codes))
                renderer.render("projector", compensate=True, steps=index % 3)
            np.testing.assert_allclose(gl.linear(), cpu.linear(), atol=ATOL)
            np.testing.assert_allclose(gl.desired(), cpu.desired(), atol=ATOL)
            drives.append(gl.linear().copy())
            for renderer in (gl, cpu):
                renderer.render("projector", compensate=True, steps=index % 3)
            np.testing.assert_array_equal(gl.linear(), drives[-1])
    assert np.abs(drives[2] - drives[1]).max() > 1e-2  # the adaptation is still changing


def test_the_adaptation_of_a_large_view_matches_the_reference(
    gl_context: moderngl.Context, rng: np.random.Generator
) -> None:
    """The view has more pixels than samples and a size that tiles do not divide.

    Adaptation runs from frame to frame.
    """
    shape, white, share = (301, 523), 0.7, 0.02
    ambient = rng.uniform(0, 0.2, (*shape, 3)).astype(np.float32)
    seen = np.repeat(rng.uniform(0.3, 1, (*shape, 1)), 3, axis=2).astype(np.float32)
    most = CpuCanvas(shape, 4).draw(Reach(seen, 0 * seen, (rng.uniform(size=shape) < 0.9).astype(np.float32)))
    textures = picture_texture(gl_context, ambient), float_texture(gl_context, shape, most)
    device = GlDevice(gl_context)
    adapter = device.adapter(lambda b: b, *textures, white)
    limits = Limits(np.ones_like(ambient), ambient, ambient, most)
    adapter.set(100 * share, 1.0, 0.0)
    expected: list[np.ndarray] = []
    for power in (1.0, 3.0):
        picture = (rng.uniform(size=(*shape, 3)) ** power).astype(np.float32)
        texture = picture_texture(gl_context, picture)
        adapter.advance(cut=power == 1, duration_s=0.04)
        found = np.frombuffer(adapter.run(texture).read(), np.float32)[:2]
        texture.release()
        target = adaptation.tone_of(picture, picture, limits, white, share)
        expected.append(target if power == 1 else expected[0] + approach(0.04) * (target - expected[0]))
        np.testing.assert_allclose(found, expected[-1], atol=ATOL)
        assert 0.3 < found[0] < 0.95
        assert 0 < found[1] < 0.2
    for resource in (adapter, *textures, device):
        resource.release()


def test_a_neutral_picture_is_bit_for_bit_what_the_bare_passes_give(
    gl_context: moderngl.Context, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The reference pipeline omits player/pipeline/adjustments.py, and its shader has no brightness."""
    room, frame = random_room(rng, far=False, dither="noise"), yuv_frame(rng, (9, 15))
    with both(gl_context, room, frame) as (gl, _):
        gl.adjust(
            Adjustments(brightness=9, gamma=30, saturation=-40, black_level=0.1, adapt=3, flicker=0.5, clipping=True)
        )
        gl.render("projector", compensate=True)
        gl.adjust(Adjustments())
        gl.render("projector", compensate=True, frame=7)
        found, codes, desired = gl.linear().tobytes(), gl.encoded().tobytes(), gl.desired().tobytes()
        limits = np.frombuffer(gl._main_view.views.full.read(), np.float32).reshape(*CAMERA, 4)
    original = shaders.read_source
    bare = original("planes_to_linear.frag").replace(" + lift;", ";").replace("uniform float lift;", "")
    assert "lift" not in bare
    monkeypatch.setattr(shaders, "read_source", lambda name: bare if name.startswith("planes") else original(name))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Planes, "adjust", lambda self, picture: None)
        decoder = Planes(gl_context, frame.format)
    decoder._pass.set(to_rgb=tuple(decoding_of(frame.format).to_rgb.T.ravel()))
    device = GlDevice(gl_context)
    fitter, ambient = Fitter(device, frame.format, CAMERA), picture_texture(gl_context, room.calibration.ambient)
    asked = ShaderPass(gl_context, "desired.frag", float_texture(gl_context, CAMERA), {"FULL": None}, white=room.white)
    full = float_texture(gl_context, CAMERA, limits)
    textures = MapTextures(gl_context, room.maps.correction)
    correct = textures.product("CLAMP")
    table = table_texture(gl_context, room.calibration.projectors[0].response.inverse_table())
    target = gl_context.texture(PROJECTOR[::-1], 4, dtype="f1")
    encode = ShaderPass(gl_context, "encode.frag", target, {"DITHER_NOISE": None}, scale=1.0, highest=255, frame=7)
    decoder.upload(frame.planes)
    placed = fitter.run(decoder.run())
    drive = correct.run(asked.run(picture=placed, ambient=ambient, full=full))
    encode.run(picture=drive, inverse_response=table)
    assert read(drive).tobytes() == found
    assert read(target, np.uint8).tobytes() == codes
    assert (np.float32(room.white) * read(placed)).tobytes() == desired
    for resource in (decoder, fitter, ambient, full, asked, textures, correct, table, encode, device):
        resource.release()


@pytest.mark.parametrize("name", CARDS)
def test_a_card_is_sent_as_it_is(gl_context: moderngl.Context, rng: np.random.Generator, name: str) -> None:
    with both(gl_context, physical_room(rng).room, scene(rng)) as renderers:
        for renderer in renderers:
            renderer.adjust(Adjustments(card=name, brightness=50, adapt=5, flicker=0.9, clipping=True))
            renderer.render("projector", compensate=True, steps=3)
            np.testing.assert_array_equal(renderer.linear(), card(name, PROJECTOR))
            assert renderer.certificate() is None
        for view in ("camera", "split", "error"):
            for renderer in renderers:
                renderer.render(view, compensate=True)
            np.testing.assert_allclose(renderers[0].linear(), renderers[1].linear(), atol=ATOL)


def test_properties_outlive_a_medium(gl_context: moderngl.Context, rng: np.random.Generator) -> None:
    codes, radiance = scene(rng), radiance_frame(rng.uniform(0, 0.9, (*CAMERA, 3)).astype(np.float32))
    with both(gl_context, physical_room(rng).room, codes) as (gl, cpu):
        for renderer in (gl, cpu):
            renderer.adjust(PICTURES["everything"])
        for frame in (radiance, yuv_frame(rng, (20, 11)), codes):
            for renderer in (gl, cpu):
                renderer.open(frame.format)
                renderer.upload(frame)
                renderer.render("projector", compensate=True)
            np.testing.assert_allclose(gl.linear(), cpu.linear(), atol=ATOL)


def test_properties_may_be_set_before_a_medium_is_opened(
    gl_context: moderngl.Context, rng: np.random.Generator
) -> None:
    room, frame = physical_room(rng).room, scene(rng)
    gl, drives = GlRenderer(gl_context, room), []
    for order in (("adjust", "open"), ("open", "adjust")):
        for step in order:
            if step == "open":
                gl.open(frame.format)
            else:
                gl.adjust(NEUTRAL)
                gl.adjust(PICTURES["everything"])
        gl.upload(frame)
        gl.render("projector", compensate=True)
        drives.append(gl.linear().tobytes())
    gl.release()
    assert drives[0] == drives[1]


def test_frames_allocate_nothing_whatever_is_on(gl_context: moderngl.Context, rng: np.random.Generator) -> None:
    frame = scene(rng)
    with both(gl_context, physical_room(rng).room, frame) as (gl, _):

        def play(index: int) -> None:
            for picture in (
                PICTURES["everything"],
                Adjustments(clipping=True),
                Adjustments(card=CARDS[index % len(CARDS)]),
            ):
                gl.adjust(picture)
                for view in VIEWS:
                    gl.upload(frame)
                    gl.render(view, compensate=True, frame=index, steps=1)

        play(0)
        before = len(gl_context.objects)
        for index in range(10):
            play(index)
        assert len(gl_context.objects) == before


@pytest.mark.parametrize("name", ["neutral", "pinned", "mirrored", "everything"])
def test_a_picture_on_the_screen_of_two_cameras_matches_the_reference(
    gl_context: moderngl.Context, rng: np.random.Generator, name: str
) -> None:
    physical = physical_room(rng).room
    room = replace(physical, calibration=replace(physical.calibration, screen=split_screen(CAMERA, 6)))
    with both(gl_context, room, scene(rng)) as (gl, cpu), both(gl_context, physical, scene(rng)) as (plain, _):
        for renderer in (gl, cpu, plain):
            renderer.adjust(PICTURES.get(name, NEUTRAL))
            renderer.render("projector", compensate=True)
        np.testing.assert_allclose(gl.linear(), cpu.linear(), atol=ATOL)
        np.testing.assert_allclose(gl.desired(), cpu.desired(), atol=ATOL)
        assert np.abs(gl.desired() - plain.desired()).max() > 0.1


def test_radiance_is_of_the_cameras_pixel_by_pixel(gl_context: moderngl.Context, rng: np.random.Generator) -> None:
    """Corners place a picture on the screen. They do not move radiance."""
    physical = physical_room(rng).room
    room = replace(physical, calibration=replace(physical.calibration, screen=split_screen(CAMERA, 6)))
    frame = radiance_frame(rng.uniform(0, 1.5, (*CAMERA, 3)).astype(np.float32))
    with both(gl_context, room, frame) as (gl, cpu):
        for renderer in (gl, cpu):
            renderer.adjust(Adjustments(corners=PINNED))
            renderer.render("projector", compensate=True)
            np.testing.assert_allclose(renderer.desired(), np.stack(frame.planes, axis=-1)[:, : CAMERA[1]], atol=1e-6)
        np.testing.assert_allclose(gl.linear(), cpu.linear(), atol=ATOL)

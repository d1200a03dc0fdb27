"""Every shader against its CPU function, alone and in the player's chain."""

from dataclasses import replace

import moderngl
import numpy as np
import pytest

from counterlight.errors import InputError
from counterlight.gl import device, shaders
from counterlight.gl.device import GlDevice
from counterlight.gl.gpu_maps import MapTextures
from counterlight.gl.passes import ShaderPass, float_texture, table_texture
from counterlight.gl.renderer import GlRenderer
from counterlight.gl.shaders import ShaderError, build_program
from counterlight.maps.row_map import PreparedRows, RowMap, SparseRows, pack
from counterlight.media.frames import radiance_frame
from counterlight.passes.refinement_step import Ties
from counterlight.pipeline.cpu_renderer import CpuRenderer
from counterlight.pipeline.room import DITHERS
from counterlight.response import parse_response
from tests.oracles import encoding, formulas
from tests.oracles.renderer import ReferenceDevice
from tests.refined_rooms import physical_room
from tests.renderers import both, read
from tests.rooms import (
    CAMERA,
    MIXED,
    PROCESSED,
    PROJECTOR,
    SEGMENTED,
    UNLIKE,
    in_strips,
    in_two_rows,
    random_map,
    random_room,
    rgb_frame,
    yuv_frame,
)

FLOAT_ATOL = 1e-5  # the required tolerance; float32 sums of at most 20 terms of size 3 are far below
CODE_ATOL = 1  # a float32 rounding may tip one code value


def upload(context: moderngl.Context, picture: np.ndarray) -> moderngl.Texture:
    rgba = np.concatenate([picture, np.ones((*picture.shape[:2], 1))], axis=2).astype(np.float32)
    return float_texture(context, picture.shape[:2], rgba)


@pytest.mark.parametrize("combine", ["", "ADD_TO_BASE", "SUBTRACT_FROM_BASE", "CLAMP"])
@pytest.mark.parametrize(("output", "source"), [((7, 13), (11, 17)), ((19, 3), (2, 31)), ((1, 6), (11, 17))])
def test_a_row_map_matches_the_reference(
    gl_context: moderngl.Context,
    rng: np.random.Generator,
    combine: str,
    output: tuple[int, int],
    source: tuple[int, int],
) -> None:
    packed = random_map(rng, output, source, 20)
    picture = rng.uniform(-1, 1, (*source, 3)).astype(np.float32)
    base = rng.uniform(-1, 1, (*output, 3)).astype(np.float32)
    product = PreparedRows(packed).apply(picture)
    expected = {
        "": product,
        "ADD_TO_BASE": base + product,
        "SUBTRACT_FROM_BASE": base - product,
        "CLAMP": np.clip(product, 0, 1),
    }[combine]
    textures = MapTextures(gl_context, packed)
    step = textures.product(combine)
    inputs = [upload(gl_context, picture), upload(gl_context, base)]
    result = read(step.run(inputs[0], inputs[1] if "BASE" in combine else None))
    for resource in (step, textures, *inputs):
        resource.release()
    np.testing.assert_allclose(result, expected, atol=FLOAT_ATOL)


@pytest.mark.parametrize("combine", ["", "ADD_TO_BASE", "CLAMP"])
@pytest.mark.parametrize("wide", [False, True])
def test_a_map_in_tiles_is_the_map_in_one(
    gl_context: moderngl.Context, rng: np.random.Generator, combine: str, wide: bool
) -> None:
    """Bit-identical: each row is summed by one draw, in the same order. Rows without entries are drawn anywhere."""
    packed = random_map(rng, (7, 13), (11, 17), 20)
    empty = packed.lookup[..., 2] == 0
    assert empty.any()
    packed.lookup[empty] = 999, 999, 0
    if wide:
        index, entries = packed.entries[..., 3].astype(np.uint32), packed.entries * np.float32([1, 1, 1, 0])
        packed = replace(packed, entries=entries, index=index)
    inputs = [upload(gl_context, rng.uniform(-1, 1, (*shape, 3)).astype(np.float32)) for shape in ((11, 17), (7, 13))]
    results = []
    for texels in (1 << 20, 5 * packed.entries.shape[1], 1):
        textures = MapTextures(gl_context, packed, texels)
        step = textures.product(combine)
        results.append(
            (len(textures.tiles), read(step.run(inputs[0], inputs[1] if combine == "ADD_TO_BASE" else None)))
        )
        for resource in (step, textures):
            resource.release()
    for texture in inputs:
        texture.release()
    height = packed.entries.shape[0]
    assert [count for count, _ in results] == [1, -(-height // 5), height]
    for _, found in results[1:]:
        np.testing.assert_array_equal(found, results[0][1])


@pytest.mark.parametrize("wide", [False, True])
def test_indices_are_exact_up_to_the_last_source_pixel(gl_context: moderngl.Context, wide: bool) -> None:
    """The source is as large as the alpha channel can address (2²⁴ pixels), or one row larger. Its corners are read."""
    source = (4096 + wide, 4096)
    last = source[0] * source[1] - 1
    indices = np.array([0, 4095, 4096, last - 4096, last - 1, last, (1 << 24) - 1, (1 << 24) - 4097])
    rows = SparseRows(np.arange(indices.size + 1), indices, np.ones((indices.size, 3), np.float32), last + 1)
    packed = pack(rows, (1, indices.size), source)
    assert (packed.index is not None) == wide
    # Each source pixel holds its own coordinates, so a wrong texel shows.
    picture = np.zeros((*source, 4), np.float32)
    picture[..., 0], picture[..., 1] = np.arange(source[1]), np.arange(source[0])[:, None]
    textures = MapTextures(gl_context, packed)
    step = textures.product()
    texture = float_texture(gl_context, source, picture)
    result = read(step.run(texture))[0]
    for resource in (step, textures, texture):
        resource.release()
    np.testing.assert_array_equal(result[:, 0], indices % 4096)
    np.testing.assert_array_equal(result[:, 1], indices // 4096)


@pytest.mark.parametrize("far", [False, True])
@pytest.mark.parametrize("view", ["projector", "camera", "split"])
@pytest.mark.parametrize("compensate", [False, True])
def test_every_view_matches_the_reference(
    gl_context: moderngl.Context, rng: np.random.Generator, far: bool, view: str, compensate: bool
) -> None:
    room, frame = random_room(rng, far=far), yuv_frame(rng, (9, 15))
    with both(gl_context, room, frame) as (gl, cpu):
        for renderer in (gl, cpu):
            renderer.render(view, compensate=compensate)
        assert gl.linear().shape == cpu.linear().shape
        np.testing.assert_allclose(gl.linear(), cpu.linear(), atol=2 * FLOAT_ATOL)  # two row maps in sequence
        assert np.abs(gl.encoded().astype(int) - cpu.encoded()).max() <= CODE_ATOL
        np.testing.assert_allclose(gl.desired(), cpu.desired(), atol=FLOAT_ATOL)


def test_the_corrected_drive_follows_the_equation(gl_context: moderngl.Context, rng: np.random.Generator) -> None:
    """Thesis eq. 5.1 with dense matrices, limited to what each pixel can show. An EXR frame is c unchanged."""
    room = random_room(rng, far=False)
    radiance = rng.uniform(0, 1, (*CAMERA, 3)).astype(np.float32)
    T_pinv = dense(room.maps.correction)
    full = np.stack([T.sum(axis=1) for T in dense(room.maps.transport)], axis=1)
    b = np.clip((radiance.astype(float) - room.calibration.ambient).reshape(-1, 3), 0, full)
    expected = np.stack([T_pinv[i] @ b[:, i] for i in range(3)], axis=1)
    with both(gl_context, room, radiance_frame(radiance)) as (gl, cpu):
        for renderer in (gl, cpu):
            renderer.render("projector", compensate=True)
            result = renderer.linear().reshape(-1, 3)
            np.testing.assert_allclose(result, np.clip(expected, 0, 1), atol=FLOAT_ATOL)


@pytest.mark.parametrize(
    "changes",
    [
        {"matrix": "bt601"},
        {"matrix": "bt2020", "depth": 10},
        {"full_range": True, "chroma_siting": "center"},
        {"chroma_siting": "topleft", "depth": 12},
        {"rotation": 90},
        {"rotation": 180},
        {"rotation": 270, "pixel_aspect": 1.5},
        {"transfer": "srgb"},
        {"transfer": "gamma28"},
    ],
)
def test_every_pixel_format_matches_the_reference(
    gl_context: moderngl.Context, rng: np.random.Generator, changes: dict[str, object]
) -> None:
    room, frame = random_room(rng, far=False), yuv_frame(rng, (9, 15), **changes)
    with both(gl_context, room, frame) as (gl, cpu):
        np.testing.assert_allclose(gl.desired(), cpu.desired(), atol=FLOAT_ATOL)


def test_stored_codes_become_the_light_that_the_standards_say(gl_context: moderngl.Context) -> None:
    """Black, white, grey and the primaries have known light, so a common error of both backends would show."""
    codes = np.array([[[0, 0, 0], [255, 255, 255], [188, 188, 188]], [[255, 0, 0], [0, 255, 0], [0, 0, 255]]], np.uint8)
    light = np.where(codes == 188, ((188 / 255 + 0.055) / 1.055) ** 2.4, codes / 255)  # IEC 61966-2-1
    rng = np.random.default_rng(5)
    room = random_room(rng, far=False)
    room = replace(room, white=1.0)
    with both(gl_context, room, rgb_frame(np.kron(codes, np.ones((8, 8, 1), np.uint8)))) as renderers:
        for renderer in renderers:
            desired = renderer.desired()
            rows, columns = (np.array(desired.shape[:2]) * [[1], [3]] // [[4], [4]])[:, 0], [2, 8, 14]
            # error of the table's interpolation
            np.testing.assert_allclose(desired[np.ix_(rows, columns)], light, atol=2e-6)


@pytest.mark.parametrize(
    ("dither", "response", "bits"),
    [("ordered", "srgb", 8), ("noise", "linear", 8), ("none", "2.2", 8), ("ordered", "2.2", 10), ("none", "srgb", 10)],
)
def test_encoding_matches_the_reference(
    gl_context: moderngl.Context, rng: np.random.Generator, dither: str, response: str, bits: int
) -> None:
    light = rng.uniform(-0.2, 1.3, (17, 23, 3)).astype(np.float32)
    light[0, :3] = [[0, 0, 0], [1, 1, 1], [1e-6, 1e-4, 0.999999]]
    table = parse_response(response).inverse_table()
    defines = {} if dither == "none" else {f"DITHER_{dither.upper()}": None}
    highest = 2**bits - 1
    target = gl_context.texture((23, 17), 4, dtype="f4")
    step = ShaderPass(gl_context, "encode.frag", target, defines, scale=1.0, highest=highest)
    if dither == "noise":
        step.set(frame=77)
    resources = upload(gl_context, light), table_texture(gl_context, table)
    step.run(picture=resources[0], inverse_response=resources[1])
    result = np.rint(read(target, np.float32) * highest).astype(int)
    for resource in (step, *resources):
        resource.release()
    expected = encoding.encode(light, table, 1.0, dither, 77, bits=bits).astype(int)
    assert expected.max() == highest
    assert np.abs(result - expected).max() <= CODE_ATOL
    # rounding differs rarely: for a threshold within 1e-6 of the code
    assert np.mean(result != expected) < 0.01 * (bits - 7)


@pytest.mark.parametrize("dither", DITHERS)
@pytest.mark.parametrize("strips", [UNLIKE, SEGMENTED, PROCESSED], ids=["curves", "white segment", "processing"])
def test_each_part_of_a_raster_is_encoded_for_its_own_projector(
    gl_context: moderngl.Context, rng: np.random.Generator, dither: str, strips: tuple[tuple[int, object], ...]
) -> None:
    alone = random_room(rng, far=False, dither=dither)
    frame, shown = yuv_frame(rng, (9, 15)), {}
    alike = tuple((width, "srgb") for width, _ in strips)
    for name, each in (("unlike", strips), ("alike", alike), ("mixed", ((6, MIXED), (7, "srgb")))):
        with both(gl_context, in_strips(alone, each), frame) as (gl, reference):
            for renderer in (gl, reference):
                renderer.render("projector", compensate=True, frame=7)
            assert np.mean(gl.encoded() != reference.encoded()) < 0.01  # rounding, as above
            shown[name] = gl.encoded()
    with both(gl_context, alone, frame) as (gl, _):
        gl.render("projector", compensate=True, frame=7)
        np.testing.assert_array_equal(gl.encoded(), shown["alike"])
    for name, first, last in (("unlike", 4, 10), ("mixed", 0, 6)):
        other = np.any(shown[name] != shown["alike"], axis=(0, 2))
        np.testing.assert_array_equal(np.flatnonzero(other), np.arange(first, last))


def test_projectors_in_two_rows_are_encoded_as_by_the_reference(
    gl_context: moderngl.Context, rng: np.random.Generator
) -> None:
    drive = rng.uniform(0, 1, (10, 13, 3)).astype(np.float32)
    light = upload(gl_context, drive)
    device = GlDevice(gl_context)
    encoder = device.encoder((10, 13), in_two_rows(), 1.0, "ordered")
    result = read(encoder.run(light, 5), np.uint8)
    for resource in (encoder, light):
        resource.release()
    expected = ReferenceDevice().encoder((10, 13), in_two_rows(), 1.0, "ordered").run(drive, 5)
    assert np.mean(result != expected) < 0.01  # rounding, as above


@pytest.mark.parametrize("dither", ["ordered", "noise"])
def test_dithering_keeps_the_mean_and_the_ends(dither: str) -> None:
    table = parse_response("linear").inverse_table()
    for value in (0.0, 1.0):
        assert np.all(encoding.encode(np.full((8, 8, 3), value), table, 1.0, dither) == round(255 * value))
    flat = encoding.encode(np.full((64, 64, 3), 100.3 / 255), table, 1.0, dither)
    assert set(np.unique(flat)) == {100, 101}
    # Ordered: 64 steps of 1/64. Noise: 12288 independent draws, four standard deviations of √(0.21/12288).
    assert flat.mean() == pytest.approx(100.3, abs=1 / 64 + 0.017)


def test_a_resampled_constant_stays_constant_and_letterboxes_are_black(rng: np.random.Generator) -> None:
    placed = formulas.resample(np.full((40, 30, 3), 0.7), (20, 50), (17, 0, 15, 20))
    np.testing.assert_allclose(placed[:, 17:32], 0.7, atol=1e-12)  # weights sum to 1
    assert placed[:, :17].max() == placed[:, 32:].max() == 0


def test_rendering_again_allocates_nothing(gl_context: moderngl.Context, rng: np.random.Generator) -> None:
    room, frame = random_room(rng, far=True), yuv_frame(rng, (9, 15))
    with both(gl_context, room, frame) as (gl, _):
        gl.render("split", compensate=True)
        before = len(gl_context.objects)
        for index in range(50):
            gl.upload(frame)
            gl.render("split", compensate=True, frame=index)
            gl.render("projector", compensate=True, frame=index)
        assert len(gl_context.objects) == before


def test_an_exr_of_another_size_is_refused(gl_context: moderngl.Context, rng: np.random.Generator) -> None:
    room = random_room(rng, far=False)
    frame = radiance_frame(np.zeros((*PROJECTOR, 3), np.float32))
    gl = GlRenderer(gl_context, room)
    for renderer in (gl, CpuRenderer(room)):
        with pytest.raises(InputError, match="13x7 pixels, the camera has 17x11"):
            renderer.open(frame.format)
    gl.release()


def test_a_texture_that_the_gpu_cannot_hold_is_an_error_with_a_way_out(gl_context: moderngl.Context) -> None:
    limit = gl_context.info["GL_MAX_TEXTURE_SIZE"]
    with pytest.raises(InputError, match=rf"end at {limit}x{limit} texels.*--backend cpu"):
        float_texture(gl_context, (1, limit + 1))


def test_a_shader_error_names_file_and_line(gl_context: moderngl.Context, monkeypatch: pytest.MonkeyPatch) -> None:
    source = shaders.read_source("desired.frag").replace("b = vec4(light, 1.0);", "b = vec5(light);")
    line = source[: source.index("vec5")].count("\n") + 1
    original = shaders.read_source
    monkeypatch.setattr(shaders, "read_source", lambda name: source if name == "desired.frag" else original(name))
    with pytest.raises(ShaderError, match=rf"shaders/desired\.frag:{line}: .*vec5"):
        build_program(gl_context, "desired.frag", {"CLAMP": None})


def dense(packed: RowMap) -> np.ndarray:
    """Return (3, rows, columns) of a row map, entry by entry from its textures."""
    columns = packed.source_shape[0] * packed.source_shape[1]
    matrix = np.zeros((3, packed.lookup.shape[0] * packed.lookup.shape[1], columns))
    for row, (x, y, length) in enumerate(packed.lookup.reshape(-1, 3).astype(int)):
        for r, g, b, index in packed.entries[y, x : x + length]:
            matrix[:, row, int(index)] += (r, g, b)
    return matrix


def test_a_step_that_does_not_compile_is_refused_with_its_room(
    gl_context: moderngl.Context, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A medium is refused in every view, because a key may switch compensation on later."""
    original = shaders.read_source
    broken = "#version 330 core\nvoid main() { nothing }"
    monkeypatch.setattr(
        shaders, "read_source", lambda name: broken if name == "refinement_step.frag" else original(name)
    )
    with pytest.raises(shaders.ShaderError, match=r"refinement_step\.frag"):
        GlRenderer(gl_context, physical_room(rng).room)


@pytest.mark.parametrize("allocated", range(4))
def test_a_stepper_without_memory_leaves_no_textures(
    gl_context: moderngl.Context, monkeypatch: pytest.MonkeyPatch, allocated: int
) -> None:
    original, made = device.float_texture, []

    def limited(context: moderngl.Context, shape: tuple[int, int]) -> moderngl.Texture:
        if len(made) == allocated:
            raise InputError("the GPU has no memory")
        made.append(original(context, shape))
        return made[-1]

    monkeypatch.setattr(device, "float_texture", limited)
    gl = device.GlDevice(gl_context)
    ties = Ties(*(gl.picture(np.zeros((3, 4, 3))) for _ in range(3)))
    with pytest.raises(InputError, match="no memory"):
        gl.stepper((3, 4), ties)
    assert len(made) == allocated
    for resource in (gl, *vars(ties).values()):
        resource.release()  # the fixture finds what remains

"""Products and refined drives from words of 4 bytes against CPU functions, on both paths."""

from collections.abc import Iterator

import moderngl
import numpy as np
import pytest

from counterlight.errors import InputError
from counterlight.gl.gpu_maps import WordBuffers, WordTextures
from counterlight.gl.paths import store_maps
from counterlight.gl.renderer import GlRenderer
from counterlight.maps.small_map import SmallMap
from counterlight.maps.word_map import WordMap
from counterlight.media.frames import radiance_frame
from counterlight.pipeline.cpu_renderer import CpuRenderer
from counterlight.pipeline.device import GpuPath
from counterlight.pipeline.renderer import AnyRenderer
from counterlight.pipeline.room import Room
from tests.refined_rooms import physical_room
from tests.renderers import multiply
from tests.rooms import CAMERA
from tests.small_rooms import as_long, random_small, with_words

ATOL = 1e-5  # float32 sums of at most 300 terms below 1, as in test_paths
STORES = {"fragment": WordTextures, "compute": WordBuffers}
COMBINES = ("", "ADD_TO_BASE", "SUBTRACT_FROM_BASE", "WEIGHED_RESIDUAL", "CLAMP")


def combined(small: SmallMap, picture: np.ndarray, base: np.ndarray, combine: str) -> np.ndarray:
    product = small.unpacked().apply(picture.reshape(-1, 3)).reshape(base.shape)
    residual = base - product
    results = {
        "": product,
        "ADD_TO_BASE": base + product,
        "SUBTRACT_FROM_BASE": residual,
        "CLAMP": np.clip(product, 0, 1),
    }
    return np.asarray(results.get(combine, small.gain * residual))


@pytest.mark.parametrize("path", STORES)
@pytest.mark.parametrize("combine", COMBINES)
@pytest.mark.parametrize(("output", "source"), [((7, 13), (11, 17)), ((19, 3), (200, 131)), ((1, 6), (41, 17))])
@pytest.mark.parametrize("longest", [1, 20, 300])
def test_a_product_matches_the_reference(
    gl_context: moderngl.Context,
    rng: np.random.Generator,
    path: str,
    combine: str,
    output: tuple[int, int],
    source: tuple[int, int],
    longest: int,
) -> None:
    """Rows have 0 to `longest` entries, some with jumps longer than a step. With 300, lanes share a row."""
    small = random_small(rng, output, source, longest=longest, trusted=True)
    picture = rng.uniform(-1, 1, (*source, 3)).astype(np.float32)
    base = rng.uniform(-1, 1, (*output, 3)).astype(np.float32)
    stored = STORES[path](gl_context, WordMap.of(small))
    result = multiply(gl_context, stored, picture, None if combine in ("", "CLAMP") else base, combine)
    expected = combined(small, picture, base, combine)
    if combine == "WEIGHED_RESIDUAL":  # no word states a trust of 0, so the transpose has no such entries
        result, expected = (light[small.trust.reshape(output) > 0] for light in (result, expected))  # type: ignore[union-attr]
    np.testing.assert_allclose(result, expected, atol=ATOL)


@pytest.mark.parametrize("path", STORES)
def test_no_row_reads_another_pixel(gl_context: moderngl.Context, rng: np.random.Generator, path: str) -> None:
    """The source is infinite in all unread pixels, and some rows read nothing."""
    small = random_small(rng, (10, 15), (20, 30), longest=3)
    picture = np.full((600, 3), np.inf, np.float32)
    picture[small.indices] = 0.5
    base = np.zeros((10, 15, 3), np.float32)
    assert (np.diff(small.indptr) == 0).any()
    assert np.isinf(picture).any()
    result = multiply(gl_context, STORES[path](gl_context, WordMap.of(small)), picture.reshape(20, 30, 3))
    finite = np.where(np.isinf(picture), 0, picture).reshape(20, 30, 3)
    np.testing.assert_allclose(result, combined(small, finite, base, ""), atol=ATOL)


def rendered(context: moderngl.Context, room: Room, path: str, steps: int) -> Iterator[AnyRenderer]:
    """Yield the room rendered from words, then from equal 16-byte entries on the CPU, both after `steps` steps."""
    long_room = Room(room.calibration, as_long(room.maps), room.white, start=room.start)
    frame = radiance_frame(np.random.default_rng(5).choice([0.02, 0.3, 0.9], (*CAMERA, 3)).astype(np.float32))
    for renderer in (GlRenderer(context, room, GpuPath(path, "words")), CpuRenderer(long_room)):
        renderer.open(frame.format)
        renderer.upload(frame)
        renderer.render("projector", compensate=True, steps=steps)
        yield renderer
        renderer.release()


@pytest.mark.parametrize("path", STORES)
@pytest.mark.parametrize("far", [False, True])
@pytest.mark.parametrize("steps", [1, 5, 50])
def test_refined_drives_match_the_reference(
    gl_context: moderngl.Context, rng: np.random.Generator, path: str, far: bool, steps: int
) -> None:
    room = with_words(physical_room(rng, far=far, start="grey").room)
    found = [(each.linear(), each.certificate(), each.path) for each in rendered(gl_context, room, path, steps)]
    (drive, certificate, report), (expected, on_cpu, _) = found
    np.testing.assert_allclose(drive, expected, atol=ATOL)
    assert certificate is not None
    assert on_cpu is not None
    np.testing.assert_allclose(certificate.squared_error, on_cpu.squared_error, rtol=1e-4)  # rounding to float32
    np.testing.assert_allclose(certificate.gap, on_cpu.gap, rtol=1e-3, atol=1e-5)
    assert report.light_bytes is not None
    assert 4 <= report.light_bytes < 8


@pytest.mark.parametrize("path", STORES)
def test_the_camera_s_view_is_within_the_bound(
    gl_context: moderngl.Context, rng: np.random.Generator, path: str
) -> None:
    """The same drive is shown from words and from the room's own maps."""
    room = with_words(physical_room(rng).room)
    frame = radiance_frame(rng.uniform(0, 1, (*CAMERA, 3)).astype(np.float32))
    seen = []
    for renderer in (GlRenderer(gl_context, room, GpuPath(path, "words")), CpuRenderer(room)):
        renderer.open(frame.format)
        renderer.upload(frame)
        renderer.render("camera", compensate=False)
        seen.append(renderer.linear().copy())
        renderer.release()
    assert room.maps.words is not None
    difference = np.abs(seen[0] - seen[1]).max()
    assert ATOL < difference <= 0.5 * room.maps.words.used * room.white / 255 + ATOL


@pytest.mark.parametrize("path", STORES)
def test_a_room_without_words_says_so(gl_context: moderngl.Context, rng: np.random.Generator, path: str) -> None:
    with pytest.raises(InputError, match="--entries words: the room has no words of 4 bytes"):
        store_maps(gl_context, with_words(physical_room(rng).room, 1e-4), GpuPath(path, "words"))
    stored = store_maps(gl_context, physical_room(rng).room, GpuPath(path, "auto"))
    stored.release()
    assert not stored.weighs

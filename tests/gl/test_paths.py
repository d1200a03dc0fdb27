"""Both paths of the row-map product against the CPU function: products, whole frames, the choice of the path."""

import json
from pathlib import Path

import moderngl
import numpy as np
import pytest

from counterlight import app
from counterlight.errors import InputError
from counterlight.files import exr
from counterlight.gl import gpu_maps, paths
from counterlight.gl.gpu_maps import MapBuffers, MapTextures, supports_compute
from counterlight.gl.paths import store_maps
from counterlight.maps.row_map import PreparedRows, RowMap, SparseRows, pack
from counterlight.media.frames import radiance_frame
from counterlight.pipeline.device import GpuPath, StoredMap
from counterlight.pipeline.refinement import STARTS
from counterlight.tools import build_correction_map
from tests.refined_rooms import physical_room
from tests.renderers import both, multiply
from tests.rooms import CAMERA, PROJECTOR, random_map, random_room, write_one_to_one_room, yuv_frame
from tests.small_rooms import with_words

ATOL = 1e-5  # the required tolerance; float32 sums of at most 20 terms of size 3 are far below
PATHS = ("fragment", "compute")  # shaders
AUTO = GpuPath("auto", "auto")
COMBINES = ("", "ADD_TO_BASE", "SUBTRACT_FROM_BASE", "CLAMP")


def store(context: moderngl.Context, packed: RowMap, path: str) -> StoredMap:
    return MapTextures(context, packed) if path == "fragment" else MapBuffers(context, packed)


def combined(product: np.ndarray, base: np.ndarray, combine: str) -> np.ndarray:
    sums = {"ADD_TO_BASE": base + product, "SUBTRACT_FROM_BASE": base - product, "CLAMP": np.clip(product, 0, 1)}
    return sums.get(combine, product)


def test_there_are_compute_shaders_here(gl_context: moderngl.Context) -> None:
    """Fails without compute shaders, because the tests below would then check nothing. Mesa has had them for years."""
    assert supports_compute(gl_context)


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize("combine", COMBINES)
@pytest.mark.parametrize(("output", "source"), [((7, 13), (11, 17)), ((19, 3), (2, 31)), ((1, 6), (41, 17))])
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
    """Rows have 0 to `longest` entries. With 300, several invocations share a row."""
    packed = random_map(rng, output, source, longest, scale=min(1, 20 / longest))
    assert packed.lookup[..., 2].min() < 0.2 * longest
    picture = rng.uniform(-1, 1, (*source, 3)).astype(np.float32)
    base = rng.uniform(-1, 1, (*output, 3)).astype(np.float32)
    stored = store(gl_context, packed, path)
    result = multiply(gl_context, stored, picture, base if "BASE" in combine else None, combine)
    expected = combined(PreparedRows(packed).apply(picture), base, combine)
    np.testing.assert_allclose(result, expected, atol=ATOL)


@pytest.mark.parametrize("path", PATHS)
def test_empty_rows_give_the_base_and_no_row_reads_another_pixel(gl_context: moderngl.Context, path: str) -> None:
    """The source is infinite in all unread pixels, so a padded entry that reads one gives NaN."""
    lengths = np.tile([0, 1, 0, 17, 3], 30)
    indptr = np.concatenate([[0], np.cumsum(lengths)])
    indices = np.arange(indptr[-1]) % 40 + 60
    packed = pack(SparseRows(indptr, indices, np.ones((indptr[-1], 3), np.float32), 180), (10, 15), (9, 20))
    picture = np.full((9, 20, 3), np.inf, np.float32)
    picture.reshape(-1, 3)[60:100] = 0.5
    base = np.full((10, 15, 3), 2.0, np.float32)
    result = multiply(gl_context, store(gl_context, packed, path), picture, base, "ADD_TO_BASE")
    np.testing.assert_array_equal(result, np.broadcast_to((2 + lengths / 2).reshape(10, 15, 1), result.shape))


@pytest.mark.parametrize("path", PATHS)
def test_a_map_without_entries_gives_black(gl_context: moderngl.Context, path: str) -> None:
    empty = SparseRows.empty(6, 20)
    stored = store(gl_context, pack(empty, (2, 3), (4, 5)), path)
    assert not multiply(gl_context, stored, np.ones((4, 5, 3), np.float32)).any()


def test_a_map_in_several_buffers_is_one_map(
    gl_context: moderngl.Context, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    packed = random_map(rng, (40, 50), CAMERA, 30)
    picture = rng.uniform(-1, 1, (*CAMERA, 3)).astype(np.float32)
    monkeypatch.setattr(gpu_maps, "PART_ENTRIES", 6000)
    stored = MapBuffers(gl_context, packed)
    assert len(stored.parts) > 3
    np.testing.assert_allclose(multiply(gl_context, stored, picture), PreparedRows(packed).apply(picture), atol=ATOL)


def test_a_source_beyond_what_a_float_counts_is_read_at_its_corners(gl_context: moderngl.Context) -> None:
    source = (4097, 4096)
    last = source[0] * source[1] - 1
    indices = np.array([0, 4095, 4096, last - 4096, last - 1, last])
    packed = pack(SparseRows(np.arange(7), indices, np.ones((6, 3), np.float32), last + 1), (1, 6), source)
    assert packed.index is not None
    picture = np.zeros((*source, 3), np.float32)
    picture[..., 0], picture[..., 1] = np.arange(source[1]), np.arange(source[0])[:, None]
    result = multiply(gl_context, MapBuffers(gl_context, packed), picture)[0]
    np.testing.assert_array_equal(result[:, :2], np.stack([indices % 4096, indices // 4096], axis=1))


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize("far", [False, True])
@pytest.mark.parametrize("start", STARTS)
def test_refined_drives_match_the_reference(
    gl_context: moderngl.Context, rng: np.random.Generator, path: str, far: bool, start: str
) -> None:
    room = physical_room(rng, far=far, start=start).room
    frame = radiance_frame(rng.choice([0.02, 0.3, 0.9], (*CAMERA, 3)).astype(np.float32))
    for steps in (0, 1, 5, 50):
        with both(gl_context, room, frame, GpuPath(path)) as (gl, cpu):
            for renderer in (gl, cpu):
                renderer.render("projector", compensate=True, steps=steps)
            np.testing.assert_allclose(gl.linear(), cpu.linear(), atol=ATOL)
            found, expected = gl.certificate(), cpu.certificate()
            assert found is not None
            assert expected is not None
            np.testing.assert_allclose(found.squared_error, expected.squared_error, rtol=1e-4)  # rounding to float32
            assert gl.path.to_dict() == {"name": path, "entry_bytes": 16}


@pytest.mark.parametrize("view", ["projector", "camera", "split", "error", "impossible"])
def test_every_view_by_compute_shaders_matches_the_reference(
    gl_context: moderngl.Context, rng: np.random.Generator, view: str
) -> None:
    with both(gl_context, random_room(rng, far=True), yuv_frame(rng, (9, 15)), GpuPath("compute")) as (gl, cpu):
        for renderer in (gl, cpu):
            renderer.render(view, compensate=True)
        # the error view magnifies; other views use two row maps in sequence
        tolerance = 100 * ATOL if view == "error" else 2 * ATOL
        np.testing.assert_allclose(gl.linear(), cpu.linear(), atol=tolerance)


@pytest.mark.parametrize(
    ("slow", "kept", "measured"),
    [
        ({"fragment": 1, "fragment-words": 2, "compute-words": 2}, "compute", {"fragment", "compute", "compute-words"}),
        (
            {"compute": 1, "fragment-words": 2, "compute-words": 2},
            "fragment",
            {"fragment", "compute", "fragment-words"},
        ),
        ({"compute": 2, "fragment": 1}, "fragment-words", {"fragment", "compute", "fragment-words"}),
        ({"compute": 1, "fragment": 2}, "compute-words", {"fragment", "compute", "compute-words"}),
    ],
)
def test_auto_keeps_the_fastest(
    gl_context: moderngl.Context,
    rng: np.random.Generator,
    monkeypatch: pytest.MonkeyPatch,
    slow: dict[str, int],
    kept: str,
    measured: set[str],
) -> None:
    """The measurements are real. For paths that must be slow, a time far above any frame's time is added.

    Words are measured once, on the path that is faster without words.
    """
    measure = paths.products_ms
    monkeypatch.setattr(
        paths, "products_ms", lambda context, stored: measure(context, stored) + 1e6 * slow.get(stored.report.name, 0)
    )
    stored = store_maps(gl_context, with_words(physical_room(rng).room), AUTO)
    stored.release()
    assert stored.report.name == kept
    assert stored.weighs == ("words" in kept)
    assert stored.report.measured.keys() == measured
    assert min(stored.report.measured.values()) == stored.report.measured[kept] < 1e6


def test_auto_measures_and_renders_the_same(gl_context: moderngl.Context, rng: np.random.Generator) -> None:
    room = physical_room(rng).room
    frame = radiance_frame(rng.choice([0.02, 0.3, 0.9], (*CAMERA, 3)).astype(np.float32))
    with both(gl_context, room, frame, AUTO) as (gl, cpu):
        for renderer in (gl, cpu):
            renderer.render("camera", compensate=True, steps=3)
        np.testing.assert_allclose(gl.linear(), cpu.linear(), atol=2 * ATOL)
        measured = gl.path.measured
    assert measured.keys() == {"fragment", "compute"}
    assert gl.path.name == min(measured, key=lambda name: measured[name])
    assert measured[gl.path.name] > 0


class OldContext:
    """A context that reports OpenGL 3.3."""

    version_code = 330

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context

    def __getattr__(self, name: str) -> object:
        return getattr(self._context, name)


def test_without_opengl_4_3_there_are_fragments(gl_context: moderngl.Context, rng: np.random.Generator) -> None:
    room, old = random_room(rng, far=False), OldContext(gl_context)
    assert store_maps(old, room, AUTO).report.to_dict() == {"name": "fragment", "entry_bytes": 16}  # type: ignore[arg-type]
    with pytest.raises(
        InputError, match=r"--shader compute: needs OpenGL 4\.3, found .*; use --shader fragment or auto"
    ):
        store_maps(old, room, GpuPath("compute"))  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a room with one single-colour entry per row, so that nothing is left out and a word holds an entry."""
    folder = tmp_path_factory.mktemp("paths") / "wall"
    write_one_to_one_room(folder, PROJECTOR)
    assert build_correction_map.main([str(folder), "--regularize", "none"]) in (None, 0)
    return folder


def test_files_are_rendered_on_the_path_asked_for(built: Path, tmp_path: Path, rng: np.random.Generator) -> None:
    """If OpenGL is requested without a path, files use fragments, because their results repeat."""
    exr.write_rgb(tmp_path / "c.exr", rng.uniform(0, 0.5, (*PROJECTOR, 3)).astype(np.float32))
    drives, chosen = {}, {}
    asked = [("--backend", "gl"), *(("--shader", name) for name in ("fragment", "compute", "auto"))]
    for words in asked:
        out, stats = tmp_path / "p.exr", tmp_path / "stats.json"
        files = str(built), str(tmp_path / "c.exr"), "--output", str(out), "--stats", str(stats), "--no-config"
        assert app.main([*files, "--refine", "0", *words]) in (None, 0)
        drives[words[1:]], chosen[words[1:]] = exr.read_rgb(out), json.loads(stats.read_text())["gpu_path"]
    assert chosen["gl",] == chosen["fragment",] == {"name": "fragment", "entry_bytes": 16}
    assert chosen["compute",] == {"name": "compute", "entry_bytes": 16}
    assert chosen["auto",].keys() == {"name", "entry_bytes", "fragment_ms", "compute_ms"}
    np.testing.assert_array_equal(drives["gl",], drives["fragment",])
    np.testing.assert_allclose(drives["compute",], drives["gl",], atol=ATOL)


def test_a_path_without_a_gpu_is_refused(built: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    exr.write_rgb(tmp_path / "c.exr", np.zeros((*PROJECTOR, 3), np.float32))
    files = str(built), str(tmp_path / "c.exr"), "--output", str(tmp_path / "p.exr"), "--no-config"
    assert app.main([*files, "--backend", "cpu", "--shader", "compute"]) == 2
    assert "--shader compute: --backend cpu has no GPU to use it; leave one of them out" in capsys.readouterr().err

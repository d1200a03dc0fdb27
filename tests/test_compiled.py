"""The compiled passes against the reference in numpy; the bytes do not depend on the number of threads."""

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest

from counterlight.files.cube import read_cube
from counterlight.maps.products import kept
from counterlight.media.frames import radiance_frame
from counterlight.media.video import Frame
from counterlight.passes import combine, kernel
from counterlight.passes.pinned import Pinned
from counterlight.passes.resample import tents
from counterlight.pipeline.adjustments import NEUTRAL, Adjustments
from counterlight.pipeline.cpu_renderer import CpuDevice, CpuRenderer
from counterlight.pipeline.drift import Drift, Moved
from counterlight.pipeline.refinement import STARTS
from counterlight.pipeline.renderer import AnyRenderer
from counterlight.pipeline.room import DITHERS, Room
from counterlight.pipeline.views import VIEWS
from counterlight.show.compiling import compile_passes
from tests.coloured_rooms import with_mixing
from tests.cubes import UNIT, write_cube
from tests.oracles.formulas import resample_axis
from tests.oracles.renderer import ReferenceDevice, ReferenceRenderer
from tests.programs import python
from tests.refined_rooms import physical_room
from tests.rooms import (
    CAMERA,
    MIXED,
    PROCESSED,
    SEGMENTED,
    UNLIKE,
    in_strips,
    in_two_rows,
    random_room,
    rgb_frame,
    yuv_frame,
)

ATOL = 1e-5  # like the shaders' tolerance: float32 in sums of at most a few hundred terms of at most a few units
STEPPED = 1e-4  # eight steps, each of which reads rounded values of the previous step
PINNED = ((0.1, 0.1), (0.9, 0.0), (0.9, 0.9), (0.0, 1.0))
TURN = np.array([[1.004, 0.01, 0.4], [-0.008, 0.997, 0.7], [1e-5, -2e-5, 1]])


def opened(renderer: AnyRenderer, frame: Frame, adjustments: Adjustments = NEUTRAL) -> AnyRenderer:
    renderer.open(frame.format)
    renderer.adjust(adjustments)
    renderer.upload(frame)
    return renderer


def assert_same(room: Room, frame: Frame, adjustments: Adjustments = NEUTRAL, *, steps: int = 0) -> None:
    """Compare every view: light within the tolerance; codes differ by at most 1, from rounding."""
    pair = [opened(made(room), frame, adjustments) for made in (CpuRenderer, ReferenceRenderer)]
    for view in VIEWS:
        for renderer in pair:
            renderer.render(view, compensate=True, frame=3, steps=steps)
        ours, meant = (renderer.linear() for renderer in pair)
        np.testing.assert_allclose(ours, meant, atol=STEPPED if steps else ATOL, err_msg=view)
        codes = [renderer.encoded().astype(int) for renderer in pair]
        assert np.abs(codes[0] - codes[1]).max() <= 1, view
        assert meant.std() > 0 or view == "impossible"


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"matrix": "bt2020", "depth": 10},
        {"full_range": True, "chroma_siting": "center", "rotation": 90},
        {"chroma_siting": "topleft", "depth": 12, "rotation": 180},
        {"transfer": "srgb", "rotation": 270, "pixel_aspect": 1.5},
        {"transfer": "pq", "primaries": "bt2020", "matrix": "bt2020", "depth": 10},
        {"transfer": "hlg", "primaries": "bt2020", "matrix": "bt2020", "depth": 12, "rotation": 90},
        {"primaries": "p3"},
    ],
)
def test_every_view_of_every_format_matches_the_formula(rng: np.random.Generator, changes: dict[str, object]) -> None:
    assert_same(random_room(rng, far=True), yuv_frame(rng, (9, 15), **changes))


def test_pictures_in_rgb_and_radiance_match_the_formula(rng: np.random.Generator) -> None:
    room = random_room(rng, far=False)
    assert_same(room, rgb_frame(rng.integers(0, 256, (40, 61, 3), np.uint8)))
    assert_same(room, radiance_frame(rng.uniform(size=(*CAMERA, 3))))
    assert_same(with_mixing(physical_room(rng).room, rng), radiance_frame(rng.uniform(size=(*CAMERA, 3))))


@pytest.mark.parametrize(
    "adjustments",
    [
        Adjustments(brightness=10, contrast=-20, gamma=30, saturation=-40),
        Adjustments(black_level=0.1, flicker=0.5, clipping=True),
        Adjustments(adapt=3),
        Adjustments(corners=PINNED),
        Adjustments(card="grid"),
    ],
)
def test_adjusted_pictures_match_the_formula(rng: np.random.Generator, adjustments: Adjustments) -> None:
    assert_same(physical_room(rng).room, yuv_frame(rng, (90, 150)), adjustments)


@pytest.mark.parametrize("transfer", ["pq", "hlg"])
def test_adjusted_hdr_matches_the_formula(rng: np.random.Generator, transfer: str) -> None:
    frame = yuv_frame(rng, (90, 150), transfer=transfer, primaries="bt2020", depth=10)
    controls = Adjustments(brightness=5, saturation=30, gamma=-10, hdr_peak=4000, target_peak=100)
    for adjustments in (controls, Adjustments(tone_mapping="clip")):
        assert_same(random_room(rng, far=False), frame, adjustments)


@pytest.mark.parametrize("domain", [UNIT, ((-0.1, 0.0, 0.1), (1.1, 0.9, 1.0))])
def test_a_table_matches_the_formula(rng: np.random.Generator, domain: Any, tmp_path: Path) -> None:
    cube = read_cube(write_cube(tmp_path / "look.cube", rng, 9, domain))
    frame = yuv_frame(rng, (9, 15), transfer="pq", primaries="bt2020", depth=10)
    for lut_type in ("native", "conversion"):
        assert_same(random_room(rng, far=False), frame, Adjustments(lut=cube, lut_type=lut_type, saturation=20))


@pytest.mark.parametrize("start", STARTS)
@pytest.mark.parametrize("drawn", [False, True])
def test_refined_film_matches_the_formula(rng: np.random.Generator, start: str, drawn: bool) -> None:
    """Several frames, because refinement carries state; with and without a prior."""
    room = physical_room(rng, start=start).room
    assert room.maps.refinement is not None
    if drawn:
        prior = room.maps.refinement.prior
        weights = {name: rng.uniform(0, 0.1, prior.damping.shape).astype(np.float32) for name in vars(prior)}
        weights["right"][:, -1] = weights["down"][-1] = 0
        refinement = replace(room.maps.refinement, prior=replace(prior, **weights))
        room = replace(room, maps=replace(room.maps, refinement=refinement))
    pair = [opened(made(room), yuv_frame(rng, (9, 15))) for made in (CpuRenderer, ReferenceRenderer)]
    for _ in range(3):
        frame = yuv_frame(rng, (9, 15))
        for renderer in pair:
            renderer.upload(frame)
            renderer.render("projector", compensate=True, steps=8)
        np.testing.assert_allclose(pair[0].linear(), pair[1].linear(), atol=STEPPED)
        ours, meant = (renderer.certificate() for renderer in pair)
        assert ours is not None
        assert meant is not None
        np.testing.assert_allclose(ours.squared_error, meant.squared_error, rtol=STEPPED, atol=STEPPED)
        np.testing.assert_allclose(ours.gap, meant.gap, rtol=STEPPED, atol=STEPPED)


@pytest.mark.parametrize("strips", [None, UNLIKE, SEGMENTED, PROCESSED, ((6, MIXED), (7, "srgb"))])
@pytest.mark.parametrize("dither", DITHERS)
def test_dithers_match_the_formula(
    rng: np.random.Generator, dither: str, strips: tuple[tuple[int, object], ...] | None
) -> None:
    room = random_room(rng, far=False, dither=dither)
    room = in_strips(room, strips) if strips else room
    frame = yuv_frame(rng, (9, 15))
    ours, meant = (opened(made(room), frame) for made in (CpuRenderer, ReferenceRenderer))
    for number in (0, 7, -1):
        for renderer in (ours, meant):
            renderer.render("projector", compensate=True, frame=number)
        tipped = ours.encoded() != meant.encoded()
        assert tipped.mean() < 0.01  # a different dither threshold would change half of the pixels


@pytest.mark.parametrize("dither", DITHERS)
def test_projectors_in_two_rows_are_encoded_as_by_the_formula(rng: np.random.Generator, dither: str) -> None:
    drive = rng.uniform(0, 1, (10, 13, 3)).astype(np.float32)
    ours, meant = (
        device.encoder((10, 13), in_two_rows(), 1.0, dither).run(drive, 5)
        for device in (CpuDevice(), ReferenceDevice())
    )
    assert np.mean(ours != meant) < 0.01  # rounding may change a code, as above


def test_a_moved_picture_matches_the_formula(rng: np.random.Generator) -> None:
    room = random_room(rng, far=False)
    assert_same(replace(room, drift=Drift((Moved(TURN, np.array([0.9, 0.95, 1.0])),))), yuv_frame(rng, (9, 15)))


@pytest.mark.parametrize(
    ("count", "length", "origin", "extent"), [(300, 20, 0, 20), (20, 300, 0, 300), (40, 64, 7, 50), (1, 9, 2, 3)]
)
def test_bands_are_the_formulas_filters(
    rng: np.random.Generator, count: int, length: int, origin: int, extent: int
) -> None:
    picture = rng.uniform(size=(count, 1))
    first, weights = tents(count, length, origin, extent)
    assert first.max() + weights.shape[1] <= count
    banded = np.sum(weights * picture[first[:, None] + np.arange(weights.shape[1]), 0], axis=1)
    np.testing.assert_allclose(banded, resample_axis(picture, 0, length, origin, extent)[:, 0], atol=1e-6)


def test_a_tent_of_many_samples_leaves_out_what_the_formula_does(rng: np.random.Generator) -> None:
    """The picture is pinned into a target a hundred times smaller."""
    source, H = rng.uniform(size=(700, 900, 3)), np.array([[100.0, 3, 0], [2, 90, 1], [1e-3, 2e-3, 1]])
    drawn = [
        device.canvas((7, 9)).draw(Pinned(device.picture(source), tuple(H.T.ravel())))
        for device in (CpuDevice(), ReferenceDevice())
    ]
    np.testing.assert_allclose(*drawn, atol=ATOL)


@pytest.fixture
def one_thread_and_all() -> Iterator[tuple[int, int]]:
    before = numba.get_num_threads()
    yield 1, numba.config.NUMBA_NUM_THREADS
    numba.set_num_threads(before)


def test_the_bytes_are_the_same_on_every_run_and_with_any_threads(
    rng: np.random.Generator, one_thread_and_all: tuple[int, int]
) -> None:
    room, frame = physical_room(rng).room, yuv_frame(rng, (90, 150))
    shown = []
    for threads in (*one_thread_and_all, one_thread_and_all[1]):
        numba.set_num_threads(threads)
        renderer = opened(CpuRenderer(room), frame, Adjustments(corners=PINNED))
        renderer.render("projector", compensate=True, steps=8)
        shown.append((renderer.linear().tobytes(), renderer.encoded().tobytes()))
    assert shown[0] == shown[1] == shown[2]


def test_no_frame_compiles_anything_once_prepared() -> None:
    """Pictures of a type not compiled at startup would compile a pass during a frame. The test has its own process."""
    code = """
import numpy as np
from counterlight.show.compiling import compile_passes
compile_passes()  # before anything else imports passes
from counterlight.passes import kernel
from counterlight.pipeline.adjustments import Adjustments
from counterlight.pipeline.cpu_renderer import CpuRenderer
from counterlight.pipeline.views import VIEWS
from tests.refined_rooms import physical_room
from tests.rooms import yuv_frame
from pathlib import Path
from counterlight.files.cube import Cube
from tests.test_compiled import PINNED
for made, signatures in kernel.dispatchers():
    made.disable_compile()
    assert len(made.signatures) == len(signatures), made
rng = np.random.default_rng(1)
renderer = CpuRenderer(physical_room(rng).room)
for depth, transfer in ((8, "srgb"), (10, "hlg")):
    frame = yuv_frame(rng, (9, 15), depth=depth, transfer=transfer)
    renderer.open(frame.format)
    cube = Cube(Path("grey"), np.full((2, 2, 2, 3), 0.5, np.float32), np.zeros(3), np.ones(3))
    for adjustments in (Adjustments(lut=cube), Adjustments(adapt=3, flicker=0.5, clipping=True, corners=PINNED)):
        renderer.adjust(adjustments)
        for view in VIEWS:
            renderer.upload(frame)
            renderer.render(view, compensate=True, steps=2)
            renderer.certificate()
print("done")
"""
    assert python("-c", code).endswith("done\n")


@pytest.mark.parametrize(
    "broken",
    [
        "caching.CacheImpl._locator_classes = []",  # no folder can be written
        "caching.IndexDataCacheFile._load_index = lambda self: {}\n"
        "def full(*_): raise OSError(28, 'No space left on device')\n"
        "caching.IndexDataCacheFile.save = full",
    ],
)
def test_where_nothing_can_be_kept_it_is_compiled_every_time(broken: str) -> None:
    code = f"""
from numba.core import caching
{broken}
import numpy as np
from counterlight.passes import combine, kernel
kernel.KERNELS[:] = [each for each in kernel.KERNELS if each()[0] is combine.combined.dispatcher]
kernel.prepare()
out, one = np.zeros((2, 6), np.float32), np.ones((2, 6), np.float32)
combine.combined(np.float32(2), one, np.float32(3), one, False, out)
print(out.sum())
"""
    assert python("-c", code).split() == ["60.0"]


def of_combined() -> tuple[Any, tuple[str, ...]]:
    """Return the function and the signatures of one kernel."""
    ((made, signatures),) = (each for each in kernel.dispatchers() if each[0] is combine.combined.dispatcher)
    return made.py_func, signatures


def test_what_was_prepared_is_what_a_call_finds(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Whichever process compiles first, the cache holds one copy."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    function, signatures = of_combined()
    early, late = (kept(parallel=True, error_model="numpy")(function) for _ in range(2))
    monkeypatch.setattr(kernel, "KERNELS", [lambda: (early, signatures)])
    kernel.prepare()
    picture = np.full((2, 3), 0.25, np.float32)
    late(np.float32(1), picture, np.float32(2), picture, False, out := np.empty_like(picture))
    np.testing.assert_array_equal(out, np.float32(0.75))
    assert sum(late.stats.cache_hits.values()) == 1
    assert not late.stats.cache_misses


KNOWN = """
from counterlight.passes import kernel
from counterlight.show import compiling
kernel.prepare = lambda compiling: known.append(len(kernel.KERNELS))
known = []
compiling.compile_passes()
import counterlight.pipeline.cpu_renderer
print(known == [len(kernel.KERNELS)])
"""


def test_every_pass_is_compiled_before_the_first_frame() -> None:
    """A supervisor would end a player that compiles without heartbeats before the result is cached."""
    assert python("-c", KNOWN) == "True\n"


LOADED = """
import sys
from counterlight.maps.products import kept
from counterlight.show.compiling import compile_passes
compile_passes()
print("numba.np.linalg" in sys.modules, kept()(lambda value: value * 2)(3))
"""


def test_passes_are_loaded_without_what_only_compiling_needs() -> None:
    """Imports for compiling take longer than loading. A function that is compiled later still finds them."""
    compile_passes()  # the next process finds them in the cache
    assert python("-c", LOADED) == "False 6\n"


@pytest.mark.parametrize(("kept_in", "how"), [("a folder", "once"), (None, "at every start, since no folder")])
def test_compiling_is_said_only_where_something_is_compiled(
    kept_in: str | None, how: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    if kept_in is None:
        monkeypatch.setattr(numba.core.caching.CacheImpl, "_locator_classes", [])
    function, signatures = of_combined()
    said = []
    for _ in range(2):  # one round for each of two processes
        made = kept(parallel=True, error_model="numpy")(function)
        monkeypatch.setattr(kernel, "KERNELS", [lambda made=made: (made, signatures)])
        compile_passes()
        said.append(capsys.readouterr().out)
    assert re.fullmatch(f"compiling for this processor, {how}.*: 1 passes left\n", said[0])
    assert said[1] == ("" if kept_in else said[0])


def test_the_processor_refuses_the_weighed_residual_of_maps_in_words(rng: np.random.Generator) -> None:
    room = random_room(rng, far=False)
    with pytest.raises(ValueError, match="needs maps in words"):
        CpuDevice().store(room).of(room.maps.transport).product("WEIGHED_RESIDUAL")

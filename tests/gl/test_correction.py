"""Corrections during a show: the GPU and the CPU function agree with a room that has been calibrated that way."""

from dataclasses import replace

import moderngl
import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from counterlight.media.frames import radiance_frame
from counterlight.passes.means import Means, part
from counterlight.pipeline import correction
from counterlight.pipeline.correction import Correction, blocks_of
from counterlight.pipeline.cpu_renderer import CpuCanvas, CpuRenderer
from counterlight.pipeline.drift import Drift, Moved
from counterlight.pipeline.renderer import AnyRenderer
from counterlight.raster import Region
from counterlight.unattended.watch_link import GRID
from tests.drifted_rooms import moved_by
from tests.oracles.formulas import grid_means, reduced
from tests.renderers import both, on_gpu
from tests.rooms import random_room, yuv_frame

REGIONS = Region(0, 0, 13, 7), Region(13, 0, 11, 5), Region(0, 7, 4, 6)
ATOL = 2e-5  # float32 roundings of light up to 2, in sums of at most 100 terms
HALF_ATOL = 1e-3  # float16 below 1


def test_means_of_each_backend_equal_the_formula(gl_context: moderngl.Context, rng: np.random.Generator) -> None:
    drive = rng.uniform(0, 1, (13, 24, 3)).astype(np.float32)
    expected = reduced(drive, REGIONS, 3)
    cells = [(3, 5), (2, 4), (2, 2)]
    rows = [part(box, size, (3 * size[0], 3 * size[1])) for box, size in zip(REGIONS, cells, strict=True)]
    for made, wanted in (
        (Means(drive, np.stack(rows)), expected),
        (Means(drive, part((0, 0, 24, 13), GRID)[None]), grid_means(drive)),
    ):
        for found in (on_gpu(gl_context, made, wanted.shape[:2]), CpuCanvas(wanted.shape[:2]).draw(made)):
            np.testing.assert_allclose(found, wanted, atol=HALF_ATOL if wanted is expected else ATOL)


@pytest.mark.parametrize("painted", [False, True])
def test_a_corrected_renderer_equals_the_renderer_of_a_room_that_is_so(
    gl_context: moderngl.Context, rng: np.random.Generator, painted: bool
) -> None:
    """The field is bilinear between the middles of its cells. White is dimmer, as an automatic white would be."""
    plain, frame = random_room(rng, far=True), yuv_frame(rng, (9, 15))
    camera = plain.calibration.camera.shape
    field = rng.uniform(-0.02, 0.2, (3, 4, 3)).astype(np.float32)
    paint = rng.uniform(0.1, 1, (*camera, 3)).astype(np.float16) if painted else None
    at = [(np.arange(size) + 0.5) * cells / size - 0.5 for size, cells in zip(camera, field.shape, strict=False)]
    grid = np.meshgrid(*at, indexing="ij")
    added = np.stack([map_coordinates(field[..., i], grid, order=1, mode="nearest") for i in range(3)], axis=2)
    light = plain.ambient + added * (1 if paint is None else paint.astype(np.float32))
    so = moved_by(0.8, -0.6, 0.9), moved_by(0.1, 0.3, 1.1)
    changed = replace(
        plain,
        calibration=replace(plain.calibration, ambient=light.astype(np.float32)),
        drift=Drift(so[:1]),
        white=0.75 * plain.white,
    )
    stale = Correction(so[1:], 3 * field, paint, 0.5)
    for corrections in ([stale, Correction(so[:1], field, paint, 0.75)], []):
        room = plain if corrections else changed
        with both(gl_context, room, frame) as renderers:
            for renderer in renderers:
                for each in corrections:
                    renderer.render("projector", compensate=True)
                    renderer.correct(each)
            found = [pictures(renderer) for renderer in renderers]
        if corrections:
            corrected = found
    for ours, expected in zip(corrected, found, strict=True):
        np.testing.assert_allclose(ours, expected, atol=1e-4)  # tolerance of the moved pass (test_moved.py)


def pictures(renderer: AnyRenderer) -> np.ndarray:
    renderer.render("projector", compensate=True)
    drive = renderer.linear().copy()
    renderer.render("camera", compensate=True)
    return np.concatenate([drive.ravel(), renderer.linear().ravel()])


def test_copies_are_of_the_shown_drive(gl_context: moderngl.Context, rng: np.random.Generator) -> None:
    room, frame = random_room(rng, far=True), yuv_frame(rng, (9, 15))
    room = replace(room, drift=Drift((moved_by(0.8, -0.6, 0.9),)))
    regions = room.calibration.regions
    with both(gl_context, room, frame) as renderers:
        for renderer in (*renderers, CpuRenderer(room)):
            if isinstance(renderer, CpuRenderer):
                renderer.open(frame.format)
                renderer.upload(frame)
            renderer.render("projector", compensate=True)
            copies = renderer.copy_shown(1, GRID)
            expected = reduced(renderer.linear(), regions, 1)
            np.testing.assert_allclose(copies.picture(), expected, atol=HALF_ATOL)
            np.testing.assert_allclose(copies.grid(), grid_means(expected), atol=HALF_ATOL)


def test_row_gains_divide_the_target_and_multiply_the_prediction(
    gl_context: moderngl.Context, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The gains are bilinear between the middles of square blocks; the last blocks reach beyond the camera picture."""
    monkeypatch.setattr(correction, "MOST_BLOCKS", 20)
    room = random_room(rng, far=True)
    camera, side, blocks = room.calibration.camera.shape, 4, (3, 5)
    assert blocks_of(camera) == blocks
    gains = rng.uniform(0.5, 1.15, (*blocks, 3)).astype(np.float32)
    grid = np.meshgrid(*((np.arange(size) + 0.5) / side - 0.5 for size in camera), indexing="ij")
    undo = np.stack([map_coordinates(1 / gains[..., i], grid, order=1, mode="nearest") for i in range(3)], axis=2)
    picture = rng.uniform(0, 0.6, (*camera, 3))
    nothing = Correction((Moved.nothing(),))
    expected: list[np.ndarray] = []
    for asked, given in ((picture * undo, None), (picture, gains)):
        with both(gl_context, room, radiance_frame(asked)) as renderers:
            for number, renderer in enumerate(renderers):
                renderer.correct(nothing)
                plain = pictures(renderer)
                renderer.correct(replace(nothing, row_gains=given))
                found = pictures(renderer)
                if given is None:
                    expected.append(found)
                    continue
                drive, seen = np.split(expected[number], [-picture.size])
                wanted = np.concatenate([drive, seen / undo.ravel()])
                np.testing.assert_allclose(found, wanted, atol=1e-4)  # tolerance of the moved pass (test_moved.py)
                assert np.abs(found - plain).max() > 0.01
                renderer.correct(nothing)
                np.testing.assert_array_equal(pictures(renderer), plain)

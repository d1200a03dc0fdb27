"""Acquisition of large pictures: in bands of camera pixels, and without following smooth far light."""

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from counterlight import memory
from counterlight.tools.acquisition.acquire import Acquisition
from counterlight.tools.acquisition.schemes import bands, blocks, hierarchical
from counterlight.tools.acquisition.schemes.agreement import Reading
from counterlight.tools.acquisition.schemes.bands import Readings
from counterlight.tools.acquisition.schemes.hierarchical import HierarchicalScheme, Threshold
from counterlight.tools.acquisition.schemes.smooth import smoothed
from counterlight.tools.transport.transport import channel
from tests.acquired_rooms import QUIET, SHAPE, error, mirror, room_of, run, sharp_wall, with_far_light

BAND, TOGETHER = 100, 700  # camera pixels of a band; connections read at a time


@pytest.fixture
def in_bands(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hierarchical, "PIXELS", BAND)
    monkeypatch.setattr(bands, "CONNECTIONS", TOGETHER)


def arrays(done: Acquisition) -> list[np.ndarray]:
    transport = done.measured.transport
    assert transport.far is not None
    return [
        *(getattr(rows, name) for rows in (transport.near, transport.far.scatter) for name in ("indptr", "indices")),
        transport.near.weights,
        transport.far.scatter.weights,
        transport.far.mix.matrices,
    ]


def test_bands_of_camera_pixels_give_what_all_of_them_do(
    rng: np.random.Generator, request: pytest.FixtureRequest
) -> None:
    room = room_of(with_far_light(mirror(rng), 0.3))
    whole = run(room, HierarchicalScheme())
    request.getfixturevalue("in_bands")
    banded = run(room, HierarchicalScheme())
    assert (banded.pictures, banded.measured.notes) == (whole.pictures, whole.measured.notes)
    for one, other in zip(arrays(banded), arrays(whole), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.usefixtures("in_bands")
def test_memory_asked_for_is_that_of_some_connections(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked, check, of_band = [], memory.check, 9 * BAND

    def noted(needed: float, what: str, remedy: str) -> None:
        asked.append(needed)
        check(needed, what, remedy)

    monkeypatch.setattr(memory, "check", noted)
    done = run(room_of(sharp_wall(rng)), HierarchicalScheme())
    connections = max(int(note.split()[-3]) for note in done.measured.notes if "connections" in note)
    assert connections > 3 * of_band  # a single request for all connections would have exceeded this limit
    assert max(asked) <= hierarchical.BYTES_A_PARENT * of_band


def test_readings_on_disk_are_those_in_memory(rng: np.random.Generator, tmp_path: Path) -> None:
    levels = [
        Reading(
            rng.random((n, 4, 3)).astype(np.float32), rng.random((n, 4, 3)), rng.random((n, 4)) < 0.5, np.ones(n, bool)
        )
        for n in (5, 0, 3)
    ]
    kept, stored = Readings(None), Readings(tmp_path)
    for level in levels:
        kept.add(level)
        stored.add(level)
    assert not list(tmp_path.iterdir())  # a killed run leaves no files
    for one, other in zip(kept.taken(), stored.taken(), strict=True):
        for field in fields(Reading):
            np.testing.assert_array_equal(getattr(one, field.name), getattr(other, field.name))


def test_of_a_wide_raster_smooth_far_light_is_not_followed(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A quarter of the light is smooth far light: T is as good with far fewer pictures."""
    truth = with_far_light(sharp_wall(rng), 0.25)
    scheme = HierarchicalScheme(Threshold(absolute=5e-4))
    followed = run(room_of(truth), scheme, QUIET)
    monkeypatch.setattr(blocks, "WIDE", 0)
    left = run(room_of(truth), scheme, QUIET)
    assert left.pictures < 0.7 * followed.pictures
    assert error(left.measured.transport, truth) < error(followed.measured.transport, truth) + 0.01


def test_of_a_wide_raster_a_faint_second_place_is_still_found(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A mirror's spot differs between the quarters of a block."""
    truth = mirror(rng)
    monkeypatch.setattr(blocks, "WIDE", 0)
    found = run(room_of(truth), HierarchicalScheme())
    assert error(found.measured.transport, truth) < 0.05


def test_large_blocks_beside_a_spot_are_not_spread_over_the_pixels_of_a_wide_raster(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    raster = (256, 320)
    spot, wide = (
        blocks.BlockLight(blocks.BlockGrid(raster, side), np.array([7]), np.array([0]), np.ones((1, 3)))
        for side in (1, 8)
    )
    rim = blocks.BlockLight(blocks.BlockGrid(raster, 2), np.array([7]), np.array([1]), np.ones((1, 3)))
    for limit, entries in ((blocks.WIDE, 64), (0, 1 + 4)):
        monkeypatch.setattr(blocks, "WIDE", limit)
        transport = blocks.as_transport([spot, rim, wide], SHAPE[0])
        assert channel(transport.near, 0).nnz == entries, limit
        np.testing.assert_allclose(transport.composition()[7], 3.0, rtol=1e-6)  # rounding to float32


def test_far_light_of_few_numbers_is_left_in_its_blocks(rng: np.random.Generator) -> None:
    camera, projector, grid = (36, 52), (42, 60), blocks.BlockGrid((42, 60), 16)
    few = blocks.BlockLight(grid, np.arange(5), np.arange(5), rng.random((5, 3)))
    whole = blocks.as_transport([few], camera[0] * camera[1])
    transport, summary = smoothed(replace(whole, camera=camera, projector=projector))
    assert summary.startswith("far light: left in")
    assert transport.far is not None
    np.testing.assert_array_equal(transport.far.scatter.weights, whole.far.scatter.weights)


def test_far_light_between_nodes_gives_the_same_pictures(rng: np.random.Generator) -> None:
    camera, projector, grid = (36, 52), (42, 60), blocks.BlockGrid((42, 60), 16)
    row, column = np.mgrid[: camera[0], : camera[1]].reshape(2, -1)
    light = np.repeat((1 + row / camera[0] + column / camera[1])[:, None], grid.count, axis=1)
    pixel, block = np.nonzero(np.ones(light.shape, bool))
    part = blocks.BlockLight(grid, pixel, block, np.repeat(light.reshape(-1, 1), 3, axis=1))
    whole = blocks.as_transport([part], row.size)
    transport, summary = smoothed(replace(whole, camera=camera, projector=projector))
    assert "became" in summary, summary
    np.testing.assert_allclose(transport.composition(), whole.composition(), rtol=1e-6)  # rounding to float32
    drive = np.repeat(rng.random((whole.shape[1], 1)), 3, axis=1)
    lost = transport.apply(drive) - whole.apply(drive)
    assert np.sqrt(np.mean(lost**2) / np.mean(whole.composition() ** 2)) < 0.01  # the limit of `smoothed`, and noise

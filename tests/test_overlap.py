"""Overlap of neighbouring projector pixels in the camera, against dense matrices, and the ties that follow from it."""

import numpy as np
import pytest

from counterlight.calibration import Calibration
from counterlight.passes.colour import LUMINANCE
from counterlight.tools.transport import overlap as overlaps
from counterlight.tools.transport.objective import ObjectiveOptions, objective_of
from counterlight.tools.transport.overlap import overlap
from counterlight.tools.transport.transport import Transport
from counterlight.tools.transport.trust import camera_pixels
from tests.blurred_rooms import CAMERA, PROJECTOR, calibrated, discs, in_blocks, rows_of, written_out

IN_FOCUS, WIDE = 0.6, 6.0


def seen_by(T: Transport, rng: np.random.Generator) -> np.ndarray:
    """Return random weights w of the camera pixels, 0 for some."""
    return rng.uniform(size=T.shape[0]) * (rng.uniform(size=T.shape[0]) < 0.8)


def cosines(T: Transport, weights: np.ndarray, axis: int) -> np.ndarray:
    """Return κ of each pixel and its next neighbour along an axis, by numpy alone. That axis is one shorter."""
    light = np.tensordot(LUMINANCE, written_out(T), 1)
    gram = (light * weights[:, None]).T @ light
    root = np.sqrt(np.outer(np.diag(gram), np.diag(gram)))
    cosine = np.divide(gram, root, out=np.zeros_like(gram), where=root > 0)
    pixel = np.arange(T.shape[1]).reshape(PROJECTOR)
    here, beside = (np.take(pixel, range(first, PROJECTOR[axis] - 1 + first), axis) for first in (0, 1))
    return np.asarray(cosine[here, beside])


def inner(found: np.ndarray, axis: int) -> np.ndarray:
    return np.take(found, range(PROJECTOR[axis] - 1), axis)


def rooms(rng: np.random.Generator) -> dict[str, Transport]:
    sharp, wide = discs(rng, IN_FOCUS), discs(rng, WIDE)
    made = {"in focus": Transport(rows_of(sharp)), "wide": Transport(rows_of(wide)), "in cells": in_blocks(wide)}
    assert made["in cells"].blurred is not None
    return made


@pytest.mark.parametrize("room", ["in focus", "wide", "in cells"])
def test_cosines_are_those_of_the_matrix_written_out(
    rng: np.random.Generator, room: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(overlaps, "AT_ONCE", 500)  # small batches, so that there are many
    T = rooms(rng)[room]
    weights = seen_by(T, rng)
    for found, axis in zip(overlap(T, weights, PROJECTOR), (1, 0), strict=True):
        np.testing.assert_allclose(inner(found, axis), cosines(T, weights, axis), atol=1e-6)  # T is float32
        assert np.all(np.take(found, -1, axis) == 0)


def test_some_camera_pixels_stand_for_all_of_a_large_room(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    T = rooms(rng)["wide"]
    weights = np.ones(T.shape[0])
    whole = overlap(T, weights, PROJECTOR)
    monkeypatch.setattr(overlaps, "MOST_ENTRIES", T.entries // 3)
    for some, every in zip(overlap(T, weights, PROJECTOR), whole, strict=True):
        assert 0 < np.abs(some - every).max() < 0.1  # dozens of camera pixels see each projector pixel


@pytest.mark.parametrize("blind", [np.zeros, np.ones])
def test_a_room_without_light_or_without_trust_has_none(blind: object) -> None:
    T = Transport(rows_of(np.zeros((3, CAMERA[0] * CAMERA[1], PROJECTOR[0] * PROJECTOR[1]))))
    assert not any(each.any() for each in overlap(T, blind(T.shape[0]), PROJECTOR))  # type: ignore[operator]


def test_ties_are_as_strong_as_what_the_camera_would_see_of_a_drift(rng: np.random.Generator) -> None:
    """Where all is seen, ω = σ² (√(T_j² T_k²) − T_j T_k): half of the change when light moves across the edge."""
    for T in rooms(rng).values():
        room: Calibration = calibrated(Transport(T.near, None, CAMERA, PROJECTOR, T.blurred))
        objective = objective_of(T, room, ObjectiveOptions(drift=0.5))
        assert objective.prior is not None
        light = written_out(objective.T)
        squares = np.einsum("cij,i->jc", light**2, objective.weights).reshape(*PROJECTOR, 3)
        made = camera_pixels(objective.T, objective.weights > 0)
        known = np.minimum(np.minimum(objective.seen, made), 1).reshape(PROJECTOR)
        for ties, axis in ((objective.prior.right, 1), (objective.prior.down, 0)):
            here, beside = (np.take(squares, range(k, PROJECTOR[axis] - 1 + k), axis) for k in (0, 1))
            both = np.minimum(*(np.take(known, range(k, PROJECTOR[axis] - 1 + k), axis) for k in (0, 1)))
            apart = 1 - both * cosines(objective.T, objective.weights, axis)
            expected = 0.25 * np.sqrt(here * beside) * apart[..., None]
            np.testing.assert_allclose(inner(ties, axis), expected, rtol=1e-4, atol=1e-6)  # T is float32


def test_neighbours_that_share_a_coarse_camera_pixel_are_still_tied() -> None:
    """Each camera pixel is the mean of four projector pixels, so κ is 1 inside it.

    With a finer camera, κ may differ.
    """
    camera, projector = (8, 9), (16, 18)
    y, x = np.mgrid[: projector[0], : projector[1]].reshape(2, -1)
    T = np.zeros((3, camera[0] * camera[1], projector[0] * projector[1]))
    T[:, (y // 2) * camera[1] + x // 2, np.arange(y.size)] = 0.25
    near = Transport(rows_of(T), None, camera, projector)
    objective = objective_of(near, calibrated(near), ObjectiveOptions(drift=0.5))
    assert objective.prior is not None
    within = objective.prior.right[:, ::2]
    # v = 0.25: only a quarter of κ is trusted
    np.testing.assert_allclose(within, 0.25 * 0.25**2 * (1 - 0.25), rtol=1e-5)

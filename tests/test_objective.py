"""The objective: footprints cut by the raster's edge, unseen pixels, ties between neighbours, one bound for all."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse

from counterlight.calibration import Calibration, Device
from counterlight.errors import InputError
from counterlight.maps.mixing import Mixing
from counterlight.maps.prior import pull
from counterlight.pipeline.content import reachable_white
from counterlight.response import Response
from counterlight.tools.colour.tiers import Tier
from counterlight.tools.inverse.build import build_maps
from counterlight.tools.inverse.clustered import prior_matrices
from counterlight.tools.inverse.near_light import InverseOptions
from counterlight.tools.solve.box import TOLERANCE, Box
from counterlight.tools.transport.mask import DARK_PAINT, directly_lit, lit_pixels
from counterlight.tools.transport.objective import Objective, ObjectiveOptions, objective_of
from counterlight.tools.transport.transport import Dense, FarLight, Transport, dense_rows, stacked
from counterlight.tools.transport.trust import LEAST_TRUST, cut_by_edges, seen, trust
from tests.augmented import best, value
from tests.rooms import blurred_transport

CAMERA, PROJECTOR = (8, 24), (4, 12)
LINEAR = Response("linear")


def row_of_footprints(width: float, *, pixels: int = 60, raster: int = 20, step: float = 0.5) -> np.ndarray:
    """Return T of a line of camera pixels that see `width` projector pixels each, starting left of the raster."""
    edges = np.arange(raster + 1)
    starts = step * np.arange(pixels) - 5.0
    share = np.clip(np.minimum(edges[1:], starts[:, None] + width) - np.maximum(edges[:-1], starts[:, None]), 0, None)
    return share / width


def transport_of(T: np.ndarray) -> Transport:
    return Transport(stacked([sparse.csr_array(T.astype(np.float32))] * 3))


def calibration_of(
    T: Transport, camera: tuple[int, int], projectors: list[tuple[int, int]], mask: np.ndarray | None = None
) -> Calibration:
    ambient = np.zeros((*camera, 3), np.float32)
    counts = np.ones(camera, bool) if mask is None else mask
    devices = tuple(Device(*shape, LINEAR) for shape in projectors)
    return Calibration("room", "made by a test", devices, Device(*camera, LINEAR), ambient, counts)


@pytest.mark.parametrize("width", [1.3, 4.0])
def test_a_footprint_that_the_edge_cuts_does_not_count(width: float) -> None:
    T = row_of_footprints(width)
    coverage = T.sum(axis=1)
    lit = coverage > 0
    camera, projector = (1, len(T)), (1, T.shape[1])
    transport = transport_of(np.where(lit[:, None], T, 0))
    # The raster is one line high: columns can be judged, rows cannot.
    cut = cut_by_edges(transport, camera, projector)
    assert np.all(cut[(coverage > 0.01) & (coverage < 0.6)] > 1.1)
    assert np.all(cut[:, None][coverage > 0.999] <= 1.1)


def test_dark_paint_counts_and_does_not_make_white_dark() -> None:
    composition = np.ones((10, 10, 3))
    composition[:2] = 0.03  # a line of ink
    composition[9] = 0.004  # a line of stray light
    lit = lit_pixels(composition, np.zeros_like(composition), share=DARK_PAINT)
    assert lit[:9].all()
    assert not lit[9].any()
    assert reachable_white(composition, lit) == pytest.approx(1.0)


def test_noise_that_was_measured_is_no_light() -> None:
    composition = np.ones((10, 10, 3))
    composition[:2] = 0.03
    assert not lit_pixels(composition, np.zeros_like(composition), np.full(3, 0.01), DARK_PAINT)[:2].any()


def test_what_lies_outside_the_mask_pulls_weakly_and_what_is_dark_not_at_all() -> None:
    T = np.kron(np.eye(6), np.ones((2, 1)))
    T[3] = 0
    counts = np.ones((1, 12), bool)
    counts[0, 4:6] = False
    weights = trust(transport_of(T), counts, (1, 6))
    assert weights[4] == weights[5] == LEAST_TRUST
    counts[0, 3] = False
    assert trust(transport_of(T), counts, (1, 6))[3] == 0


def test_how_much_is_seen_does_not_depend_on_paint() -> None:
    T = np.kron(np.eye(8), np.ones((3, 1)))
    T[:3] *= 0.01  # dark ink
    T[21:] = 0  # the last projector pixel is unseen
    np.testing.assert_allclose(seen(transport_of(T), np.ones(24, bool)), [1] * 7 + [0])


def test_a_pixel_that_glass_scatters_over_the_view_makes_no_other_pixel_seem_unseen() -> None:
    T = np.zeros((400, 900))  # most projector pixels are unseen
    T[range(400), range(400)] = 1
    T[:, 400] = 0.3
    visibility = seen(transport_of(T), np.ones(400, bool))
    np.testing.assert_allclose(visibility[:400], 1)
    assert visibility[400] > 100
    np.testing.assert_array_equal(visibility[401:], 0)


def test_a_pixel_of_less_than_no_light_is_held_like_one_that_nobody_sees() -> None:
    """Factors of a dense T may give a pixel a slightly negative value; N of T⁺ was then not positive definite."""
    T = np.kron(np.eye(12), np.ones((2, 1)))
    T[22:] = 0
    gather = np.tile(np.append(np.zeros(11), -1e-9), (3, 1, 1))
    far = FarLight(dense_rows(gather), Dense(np.ones((3, 1, 1))), dense_rows(np.ones((3, 24, 1))))
    prior = objective_of(
        replace(transport_of(T), far=far), calibration_of(transport_of(T), (1, 24), [(1, 12)]), ObjectiveOptions()
    ).prior
    assert prior is not None
    np.testing.assert_allclose(prior.damping[0, 11], prior.damping.max(axis=(0, 1)))
    assert prior.damping.min() >= 0
    assert prior.damping.max() < 10


@pytest.mark.parametrize(("outside", "shown"), [("black", True), ("dark", False)])
def test_a_pixel_seen_by_bounced_light_alone_lights_up_unless_all_shall_be_dark(outside: str, *, shown: bool) -> None:
    T = np.kron(np.eye(12), np.ones((2, 1)))
    T[20:] = 0  # the camera sees the last two projector pixels by far light alone
    gather = np.full((3, 1, 12), 0.1)
    far = FarLight(dense_rows(gather), Dense(np.ones((3, 1, 1))), dense_rows(np.ones((3, 24, 1))))
    transport = replace(transport_of(T), far=far)
    room = calibration_of(transport, (1, 24), [(1, 12)], (T.sum(axis=1) > 0)[None])
    objective = objective_of(transport, room, ObjectiveOptions(outside=outside))
    drive = Box(objective).solve(np.full((24, 3), 3.0)).drive  # more light than the seen pixels give
    assert (drive[10:].min() > 0.5) == shown
    assert (drive[10:].max() < 0.5) != shown


@pytest.mark.parametrize("outside", ["black", "dark", "continue"])
def test_a_pixel_that_nobody_sees_is_dark_or_like_its_neighbours(outside: str) -> None:
    T = np.kron(np.eye(12), np.ones((2, 1)))
    T[20:] *= 0  # two projector pixels outside the view
    T[19, 10] = 1e-3  # the last camera pixel sees a trace of one of them
    transport = transport_of(T)
    room = calibration_of(transport, (1, 24), [(1, 12)], (T.sum(axis=1) > 0).reshape(1, 24))
    objective = objective_of(transport, room, ObjectiveOptions(outside=outside))
    b = np.where(T.sum(axis=1) > 0, 0.6, 0.0)[:, None] * np.ones(3)
    b[19] = 0.9  # the target of this trace is high
    drive = Box(objective).solve(b).drive
    if outside != "continue":
        assert drive[10:].max() < 0.05
        np.testing.assert_allclose(drive[:9], 0.6, atol=0.02)  # the prior of seen pixels is below 1e-3
    else:
        np.testing.assert_allclose(drive[10:], drive[[9, 9]], atol=0.1)


def test_ties_stay_within_a_projector() -> None:
    transport = transport_of(np.eye(4 * 10))
    room = calibration_of(transport, (4, 10), [(4, 6), (3, 4)])
    prior = objective_of(transport, room, ObjectiveOptions()).prior
    assert prior is not None
    assert np.all(prior.right[:, 5] == 0)
    assert np.all(prior.right[:, :5] > 0)
    assert np.all(prior.right[3, 6:] == 0)  # nothing lies below the lower projector
    assert np.all(prior.down[2, 6:] == 0)
    assert np.all(prior.down[:3, :6] > 0)


@pytest.mark.parametrize("unreachable", [-0.3, 1.7])
def test_what_a_pixel_cannot_have_spoils_no_neighbour(unreachable: float) -> None:
    T = row_of_footprints(4.0)
    transport = transport_of(T)
    objective = objective_of(transport, calibration_of(transport, (1, 60), [(1, 20)]), ObjectiveOptions())
    b, dark = np.full((60, 3), 0.3), slice(25, 31)
    b[dark] = unreachable  # below black by more than the ambient light, or above what dark paint can show
    around = np.r_[20:25, 31:36]
    asked, left = (
        np.abs(T @ Box(each).run(b)[0] - b)[around].sum() for each in (replace(objective, bounds=False), objective)
    )
    assert left < 0.9 * asked
    lit = T.sum(axis=1).clip(0, 0.3)
    lit[dark] = np.clip(unreachable, 0, 1)
    found = objective.certificate(np.zeros((20, 3)), b).squared_error
    np.testing.assert_allclose(found, np.sum(lit**2), rtol=1e-6)  # T is float32


def test_what_is_seen_is_not_held() -> None:
    transport = transport_of(np.kron(np.eye(48), np.ones((4, 1))))
    objective = objective_of(transport, calibration_of(transport, (8, 24), [(4, 12)]), ObjectiveOptions())
    assert objective.prior is not None
    d = objective.dual.apply(objective.T.composition())
    assert np.all(objective.prior.damping.reshape(-1, 3) < 1e-3 * d)


def blurred(rng: np.random.Generator, options: ObjectiveOptions) -> Objective:
    T = blurred_transport(rng, CAMERA, PROJECTOR, 0.6).tolil()
    T[:, :3] *= 0.0  # unseen projector pixels
    T = Transport(stacked([sparse.csr_array(T, dtype=np.float32)] * 3))
    mask = rng.uniform(size=CAMERA) < 0.8
    return objective_of(T, calibration_of(T, CAMERA, [PROJECTOR], mask), options)


@pytest.mark.parametrize("options", [ObjectiveOptions(), ObjectiveOptions(0.5, "continue"), ObjectiveOptions(0.0)])
def test_the_box_finds_the_objective_s_minimum(rng: np.random.Generator, options: ObjectiveOptions) -> None:
    objective = blurred(rng, options)
    b = rng.choice([0.02, 0.3, 0.9], (objective.T.shape[0], 3))
    drive = Box(objective).solve(b).drive
    for i in range(3):
        assert value(objective, drive, b, i) <= best(objective, b, i) * (1 + 2 * TOLERANCE) + 1e-9


def test_the_certificate_bounds_the_distance_to_the_objective_s_minimum(rng: np.random.Generator) -> None:
    objective = blurred(rng, ObjectiveOptions(0.5))
    b = rng.choice([0.02, 0.3, 0.9], (objective.T.shape[0], 3))
    for _ in range(5):
        drive = rng.uniform(size=(objective.T.shape[1], 3))
        gap = objective.certificate(drive, b).gap
        for i in range(3):
            distance = value(objective, drive, b, i) - best(objective, b, i)
            assert 0 <= distance <= gap[i] * (1 + 1e-6)


def test_a_prior_as_a_matrix_is_what_a_step_applies(rng: np.random.Generator) -> None:
    prior = blurred(rng, ObjectiveOptions(0.5, "continue")).prior
    assert prior is not None
    p = rng.uniform(size=(*PROJECTOR, 3))
    expected = pull(p, prior.damping, prior.right, prior.down)
    for i, P in enumerate(prior_matrices(prior, np.zeros(p[..., 0].size, np.int64))):
        # rounding to float32
        np.testing.assert_allclose((P @ p[..., i].ravel()).reshape(PROJECTOR), expected[..., i], atol=1e-6)
        assert np.abs(P - P.T).max() < 1e-6
    apart = prior_matrices(prior, np.arange(p[..., 0].size))
    np.testing.assert_allclose(apart[0].toarray(), np.diag(prior.damping[..., 0].ravel()), atol=1e-6)


def test_a_start_from_the_map_leaves_dark_what_nobody_sees(rng: np.random.Generator) -> None:
    T = Transport(stacked([sparse.csr_array(row_of_footprints(2.5, pixels=30, step=0.4).astype(np.float32))] * 3))
    camera, projector = (1, 30), (1, 20)
    mask = directly_lit(T, np.zeros((*camera, 3)), projector)
    built = build_maps(Tier(calibration_of(T, camera, [projector], mask), T, Mixing(), ""), InverseOptions(0.01))
    assert built.maps.refinement is not None
    unseen = built.maps.refinement.seen.ravel() < 0.02
    assert unseen.any()
    asked = np.abs(built.inverse.T_pinv.apply(np.ones((30, 3))))
    assert asked[unseen].max() < 0.05 * asked[~unseen].max()


@pytest.mark.parametrize("words", [{"drift": -1}, {"drift": float("nan")}, {"outside": "grey"}])
def test_options_that_make_no_sense_are_refused(words: dict[str, float]) -> None:
    with pytest.raises(InputError, match=r"--drift|--outside"):
        ObjectiveOptions(**words)  # type: ignore[arg-type]

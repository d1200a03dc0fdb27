"""Swapped sizes of imported matrices are found in smooth rooms, and never suspected where the sizes are right."""

import numpy as np
import pytest

from counterlight.tools.transport.pixel_order import misreading
from tests.pixel_orders import Csr, right_ones, smooth
from tests.studies.pixel_order import rows, swapped

CAMERA, PROJECTOR = (24, 32), (18, 30)


@pytest.mark.parametrize("what", ["camera", "projector", "both"])
@pytest.mark.parametrize(
    ("projector", "tilt", "cover", "blur"),
    [
        (PROJECTOR, 0.2, 1.0, 0.4),
        (PROJECTOR, 0.5, 0.7, 0.4),
        (PROJECTOR, 0.2, 1.4, 2.0),
        ((18, 24), 0.0, 1.0, 0.6),  # of the camera's shape, straight ahead
    ],
)
def test_swapped_sizes_are_found(what: str, projector: tuple[int, int], tilt: float, cover: float, blur: float) -> None:
    near = rows(smooth(np.random.default_rng(4), CAMERA, projector, tilt=tilt, cover=cover, blur=blur))
    given = swapped(CAMERA, projector)[what]
    found = misreading(near, *given)
    assert found is not None
    assert (found.given, found.smooth) == (given, (CAMERA, projector))
    assert found.roughness[1] < 0.25 < found.roughness[0]


def test_pixels_in_columns_are_found() -> None:
    """Pixels numbered from top to bottom first, as in MATLAB and Fortran, look smooth if the sizes are swapped."""
    T = smooth(np.random.default_rng(4), CAMERA, PROJECTOR)
    down = np.arange(T.shape[0]).reshape(CAMERA).T.ravel()
    found = misreading(rows(Csr(T[down])), CAMERA, PROJECTOR)
    assert found is not None
    assert found.smooth == (CAMERA[::-1], PROJECTOR)


@pytest.mark.parametrize("seed", range(3))
def test_right_sizes_are_not_suspected(seed: int) -> None:
    rng = np.random.default_rng(seed)
    camera, projector = (tuple(int(side) for side in rng.integers(8, 40, 2)) for _ in range(2))
    for kind, (T, *given) in right_ones(rng, camera, projector).items():
        assert misreading(rows(T), *given) is None, (kind, given)


def test_units_and_lights_that_are_none_do_not_matter() -> None:
    T = smooth(np.random.default_rng(4), CAMERA, PROJECTOR)
    for unit in (1e-12, 1e12):
        found = misreading(rows(Csr(T * unit)), CAMERA[::-1], PROJECTOR)
        assert found is not None
    assert misreading(rows(Csr(T * 0.0)), CAMERA[::-1], PROJECTOR) is None
    assert misreading(rows(Csr(T.shape)), CAMERA[::-1], PROJECTOR) is None


def test_square_pictures_cannot_be_distinguished_from_their_transposes() -> None:
    T = smooth(np.random.default_rng(4), (20, 20), PROJECTOR)
    across = np.arange(400).reshape(20, 20).T.ravel()
    assert misreading(rows(Csr(T[across])), (20, 20), PROJECTOR) is None

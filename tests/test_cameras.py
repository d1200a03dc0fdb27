"""Several cameras: their rows below each other, the screen that they share, their light, and what cannot be joined."""


import numpy as np

from counterlight import calibration
from counterlight.screen import Screen
from counterlight.tools.transport.joining_cameras import CameraOptions, joined_cameras
from counterlight.tools.transport.transport import Transport
from tests.camera_rooms import (
    FIRST,
    LEFT,
    RIGHT,
    SECOND,
    Map,
    calibration_of,
    homography,
    position_in_first,
    transport_seen,
)
from tests.rooms import blurred_transport  # noqa: F401


def seen_by(*views: tuple[tuple[int, int], Map]) -> list[tuple[calibration.Calibration, Transport]]:
    transports = [transport_seen(camera, where) for camera, where in views]
    return [(calibration_of(each, f"camera {i}"), each) for i, each in enumerate(transports)]


def shared(rooms: list[tuple[calibration.Calibration, Transport]], **options: object):
    return joined_cameras(*zip(*rooms, strict=True), "joint", CameraOptions(**options))  # type: ignore[arg-type]


def off(found: Screen, number: int, expected: np.ndarray) -> np.ndarray:
    """How far positions are from what they should be, where the first camera's have no more than an offset."""
    own = position_in_first(FIRST, LEFT)
    shift = (found.positions[found.parts[0]] - own).reshape(-1, 2)
    np.testing.assert_allclose(shift, shift[:1] + np.zeros_like(shift), atol=1e-4)  # float32 of up to a hundred pixels
    return np.linalg.norm(found.positions[found.parts[number]] - shift[0] - expected, axis=2)


def test_a_flat_wall_is_one_screen_also_where_only_the_second_camera_sees_it() -> None:
    """Maps between pictures of a plane are projective, which the screen goes on with."""
    found = shared(seen_by((FIRST, homography(LEFT)), (SECOND, homography(RIGHT))))
    assert found.calibration.screen is not None
    away = off(found.calibration.screen, 1, position_in_first(SECOND, RIGHT))
    counts = found.calibration.mask[found.calibration.views[1]]
    x = position_in_first(SECOND, RIGHT)[..., 0]
    overlap, beyond = counts & (x < FIRST[1] - 3), counts & (x > FIRST[1])
    assert min(overlap.sum(), beyond.sum()) > 200
    # Footprints cut by pixels' steps move middles by hundredths; continued over half a picture, three times that.
    assert np.percentile(away[overlap], 99) < 0.1
    assert away[beyond].max() < 0.5

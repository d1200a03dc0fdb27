"""k projectors, r cameras, colour: thesis eq. 4.1 to 4.8 as small dense systems, against numpy's least squares."""

import numpy as np
import pytest
from scipy import sparse

from counterlight.arrays import FloatArray
from counterlight.calibration import Calibration, Device
from counterlight.response import Response
from counterlight.tools.colour.tiers import tier_of
from counterlight.tools.joining.cameras import below_each_other
from counterlight.tools.joining.projectors import join_transports
from counterlight.tools.solve.registry import prepare
from counterlight.tools.transport.transport import Transport

# (height, width), unequal so that a wrong position shows
PROJECTORS, CAMERAS = ((2, 3), (1, 4)), ((5, 6), (4, 3), (6, 7))
LINEAR = Response("linear")
SYSTEMS = [(1, 1), (2, 1), (1, 2), (2, 3)]  # numbers of projectors (k) and of cameras (r)


class Systems:
    """Random system of k projectors and r cameras.

    T : per camera and projector, (primary, camera pixels, projector pixels).
    X : per camera, (camera pixels, channel, primary).
    """

    def __init__(self, rng: np.random.Generator, k: int, r: int, *, mixes: bool) -> None:
        self.projectors, self.cameras = PROJECTORS[:k], CAMERAS[:r]
        self.T = [
            [rng.uniform(0, 1, (3, _pixels(c), _pixels(p))).astype(np.float32) for p in self.projectors]
            for c in self.cameras
        ]
        # The paint and the camera determine how channels see each primary, whichever projector sends it.
        self.X = [np.eye(3) + mixes * rng.uniform(0, 0.25, (_pixels(c), 3, 3)) for c in self.cameras]
        self.e = [rng.uniform(0, 0.1, (*c, 3)).astype(np.float32) for c in self.cameras]

    def room(self, number: int) -> tuple[Calibration, Transport]:
        """Measurement by one camera: patterns of white light, floodlights of the primaries."""
        camera, X = self.cameras[number], self.X[number]
        white = [np.einsum("clm,lcn->mcn", np.swapaxes(X, 1, 2), T.astype(float)) for T in self.T[number]]
        parts = [Transport.from_matrices([sparse.csr_array(each.astype(np.float32)) for each in T]) for T in white]
        transport = join_transports(parts, self.projectors)
        light = sum(T.sum(axis=2) for T in self.T[number])  # (primary, camera pixels)
        F = np.einsum("ckl,lc->lck", X, light).reshape(3, *camera, 3)
        devices = tuple(Device(*shape, LINEAR) for shape in self.projectors)
        counts = np.ones(camera, bool)
        calibration = Calibration(
            "room", "made by a test", devices, Device(*camera, LINEAR), self.e[number], counts, F.astype(np.float32)
        )
        return calibration, transport

    def joint(self) -> tuple[Calibration, Transport]:
        calibrations, transports = zip(*(self.room(number) for number in range(len(self.cameras))), strict=True)
        return below_each_other(calibrations, transports, "joint")

    def matrix(self) -> FloatArray:
        """Returns the matrix of eq. 4.8 (4.6 for one camera, 4.2 for one projector as well).

        Rows are ordered by camera, pixel, channel; columns by projector, pixel, primary.
        """
        return np.block(
            [
                [np.einsum("ckl,lcn->cknl", X, T.astype(float)).reshape(3 * X.shape[0], -1) for T in self.T[number]]
                for number, X in enumerate(self.X)
            ]
        )

    def raster(self, drives: FloatArray) -> FloatArray:
        """Arrange drives, ordered by projector, pixel, primary, in the projectors' raster: (pixels, 3)."""
        height, width = max(h for h, _ in self.projectors), sum(w for _, w in self.projectors)
        picture, left, start = np.zeros((height, width, 3)), 0, 0
        for h, w in self.projectors:
            picture[:h, left : left + w] = drives[start : start + 3 * h * w].reshape(h, w, 3)
            left, start = left + w, start + 3 * h * w
        return picture.reshape(-1, 3)

    def seen(self, calibration: Calibration, light: FloatArray) -> FloatArray:
        """Arrange light, ordered by camera, pixel, channel, in the cameras' raster, without ambient light."""
        picture, top, start = np.zeros((*calibration.camera.shape, 3)), 0, 0
        for h, w in self.cameras:
            picture[top : top + h, :w] = light[start : start + 3 * h * w].reshape(h, w, 3)
            top, start = top + h, start + 3 * h * w
        return picture


def _pixels(shape: tuple[int, int]) -> int:
    return shape[0] * shape[1]


@pytest.mark.parametrize(("k", "r"), SYSTEMS)
def test_light_adds_up_as_the_equations_say(rng: np.random.Generator, k: int, r: int) -> None:
    """Eq. 4.1, 4.3, 4.5 and 4.7: each camera sees the light of all projectors, mixed by its channels."""
    systems = Systems(rng, k, r, mixes=True)
    calibration, transport = systems.joint()
    tier = tier_of(calibration, transport, "pixel")
    p = rng.uniform(size=systems.matrix().shape[1])
    expected = systems.seen(calibration, systems.matrix() @ p) + calibration.ambient
    found = tier.mixing.as_radiance(tier.seen(systems.raster(p)).reshape(expected.shape))
    np.testing.assert_allclose(found, expected, atol=2e-6 * expected.max())  # float32 of T, F and the mixing


@pytest.mark.parametrize("solver", ["svd", "qr"])
@pytest.mark.parametrize(("k", "r"), SYSTEMS)
def test_independent_channels_are_solved_as_one_system(rng: np.random.Generator, k: int, r: int, solver: str) -> None:
    """Eq. 4.4 and 4.7: least squares per channel over all rows and columns, for any target, reachable or not."""
    systems = Systems(rng, k, r, mixes=False)
    calibration, transport = systems.joint()
    c = rng.uniform(0, 1, systems.matrix().shape[0])
    expected = systems.raster(np.linalg.lstsq(systems.matrix(), c)[0])
    found = prepare(solver, transport).solve(systems.seen(calibration, c)).unclamped
    np.testing.assert_allclose(found, expected, atol=1e-4 * np.abs(expected).max())  # float32 of T, condition 30


@pytest.mark.parametrize(("k", "r"), SYSTEMS)
def test_mixed_channels_are_solved_as_one_system(rng: np.random.Generator, k: int, r: int) -> None:
    """Eq. 4.2, 4.6 and 4.8: the drive is recovered from camera pictures, like by least squares of all 3rmn rows."""
    systems = Systems(rng, k, r, mixes=True)
    calibration, transport = systems.joint()
    p = rng.uniform(0.2, 0.8, systems.matrix().shape[1])
    light = systems.matrix() @ p
    np.testing.assert_allclose(np.linalg.lstsq(systems.matrix(), light)[0], p, atol=1e-9)
    tier = tier_of(calibration, transport, "pixel")
    wanted = tier.mixing.on_screen(systems.seen(calibration, light) + calibration.ambient)
    found = prepare("svd", tier.transport).solve(tier.target(wanted)).unclamped
    np.testing.assert_allclose(found, systems.raster(p), atol=2e-4)  # float32 of T, F and the mixing; condition 30

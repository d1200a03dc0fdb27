"""The border of a moved picture: the light that T still describes there, and the target for it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import sparse, special

from counterlight.arrays import FloatArray
from counterlight.calibration import Calibration, Device
from counterlight.maps.mixing import Mixing
from counterlight.pipeline.cpu_renderer import CpuRenderer
from counterlight.pipeline.drift import Drift
from counterlight.pipeline.room import read_room
from counterlight.raster import Region
from counterlight.response import Response
from counterlight.tools import build_correction_map
from counterlight.tools.acquisition.floodlight_check import Known, Looked
from counterlight.tools.acquisition.plan import Noise
from counterlight.tools.solve.registry import prepare
from counterlight.tools.transport.mask import directly_lit
from counterlight.tools.transport.objective import DEFAULT_AIMS, objective_of
from counterlight.tools.transport.transport import Transport
from tests.drifted_rooms import moved_by, shifted_boxes
from tests.rooms import write_blurred_room, yuv_frame

CAMERA, PROJECTOR, BEYOND = (24, 30), (12, 15), 4  # BEYOND: projector pixels on each side of the calibrated raster
BLUR = 0.7  # σ of a footprint, projector pixels
SHIFT = 0.8, 0.6
REGIONS = (Region(0, 0, PROJECTOR[1], PROJECTOR[0]),)
QUIET = Noise(np.full(3, 1e-6), np.full(3, 1e-9))


def axis(camera: int, projector: int) -> FloatArray:
    """Return (camera, projector + 2 BEYOND): a Gaussian's share per pixel. The camera sees one pixel more per side."""
    u = -1 + (np.arange(camera)[:, None] + 0.5) * (projector + 2) / camera
    edges = np.arange(-BEYOND, projector + BEYOND + 1)
    return np.diff(special.ndtr((edges - u) / BLUR), axis=1)


@pytest.fixture(scope="module")
def unbounded() -> FloatArray:
    """Return T of a larger raster that continues on all sides: (camera pixels, larger raster's pixels)."""
    paint = np.random.default_rng(7).uniform(0.4, 1, (CAMERA[0] * CAMERA[1], 1))
    return np.asarray(paint * np.kron(axis(CAMERA[0], PROJECTOR[0]), axis(CAMERA[1], PROJECTOR[1])))


def columns() -> np.ndarray:
    """Return the indices of the calibrated raster's pixels in the larger raster."""
    larger = np.zeros([n + 2 * BEYOND for n in PROJECTOR], bool)
    larger[BEYOND:-BEYOND, BEYOND:-BEYOND] = True
    return np.flatnonzero(larger)


@pytest.fixture(scope="module")
def calibrated(unbounded: FloatArray) -> tuple[Calibration, Transport]:
    T = sparse.csr_array(unbounded[:, columns()].astype(np.float32))
    transport = Transport.from_matrices([T] * 3)
    transport = replace(transport, camera=CAMERA, projector=PROJECTOR)
    devices = [Device(height, width, Response("linear")) for height, width in (PROJECTOR, CAMERA)]
    dark = np.zeros((*CAMERA, 3), np.float32)
    mask = directly_lit(transport, dark, PROJECTOR)
    return Calibration("goes on", "made by a test", (devices[0],), devices[1], dark, mask), transport


def now(unbounded: FloatArray) -> FloatArray:
    """Return T' of the moved picture, by exact overlaps of pixel boxes."""
    larger = shifted_boxes((PROJECTOR[0] + 2 * BEYOND, PROJECTOR[1] + 2 * BEYOND), SHIFT)
    return np.asarray(unbounded @ larger.toarray()[:, columns()])


def looked(calibrated: tuple[Calibration, Transport], flood: FloatArray, noise: Noise = QUIET) -> Looked:
    black = np.zeros((*CAMERA, 3))
    white = np.repeat(flood.reshape(*CAMERA, 1), 3, axis=2)
    return Looked(Known(*calibrated), black, white, noise, np.ones(CAMERA, bool), (True,))


def test_shares_are_of_the_side_that_has_moved_outwards(
    unbounded: FloatArray, calibrated: tuple[Calibration, Transport]
) -> None:
    flood = now(unbounded).sum(axis=1)
    share = looked(calibrated, flood).share([np.ones(3)])
    assert share is not None
    from_raster = unbounded[:, columns()].sum(axis=1)
    dim = share.ravel() < 1
    # rounding to float32
    np.testing.assert_allclose(share.ravel()[dim], np.maximum(from_raster / flood, 0.05)[dim], rtol=1e-5)
    assert (share[6:-9, -3] < 0.9).all()  # pixels next to the raster
    assert (share[:-9, : -CAMERA[1] // 3] == 1).all()


def test_a_picture_that_is_where_it_was_has_all_of_its_light(
    unbounded: FloatArray, calibrated: tuple[Calibration, Transport], rng: np.random.Generator
) -> None:
    """A picture that has not moved keeps its full share, despite noise of five deviations over a few hundred pixels."""
    noise = Noise(np.full(3, 1e-3), np.full(3, 4e-4))
    flood = unbounded[:, columns()].sum(axis=1)
    sigma = np.sqrt(noise.dark[0] ** 2 + noise.gain[0] * flood) / 2  # mean of four captures
    assert looked(calibrated, flood + sigma * rng.standard_normal(flood.size), noise).share([np.ones(3)]) is None
    assert looked(calibrated, 0.8 * flood).share([np.full(3, 0.8)]) is None


def test_asked_for_its_share_the_border_arrives_as_it_would_have(
    unbounded: FloatArray, calibrated: tuple[Calibration, Transport]
) -> None:
    """The reference is the light of a continuing raster at the moved position.

    Without shares, the border is too bright.
    """
    room, transport = calibrated
    T = now(unbounded)
    v, u = np.mgrid[: PROJECTOR[0] + 2 * BEYOND, : PROJECTOR[1] + 2 * BEYOND]
    wanted = unbounded @ (0.4 + 0.05 * np.sin(0.2 * u + 0.15 * v)).ravel()
    share = looked(calibrated, T.sum(axis=1)).share([np.ones(3)])
    assert share is not None
    errors = []
    for mixing in (Mixing(), Mixing().shared(share)):
        b = mixing.unmixed(np.repeat(wanted.reshape(*CAMERA, 1), 3, axis=2))
        objective = objective_of(transport, room, DEFAULT_AIMS, mixing)
        drive = prepare("box", transport, room.mask, objective).solve(b).drive.reshape(*PROJECTOR, 3)
        shown = Drift((moved_by(*SHIFT),)).shown(np.clip(drive, 0, 1), REGIONS)[..., 0]
        error = (T @ shown.ravel() - wanted).reshape(CAMERA)
        errors.append(float(np.abs(error[5:-5, -9:-3]).max()))
    assert errors[0] > 0.012
    assert errors[1] < 0.6 * errors[0]  # 0.43 here; the remaining error comes from the mirrored border


def test_shares_divide_what_is_asked_and_multiply_what_is_seen(rng: np.random.Generator) -> None:
    share = rng.uniform(0.1, 1, (4, 5)).astype(np.float32)
    light = rng.uniform(0, 1, (4, 5, 3))
    pixel = (np.eye(3) + 0.1 * rng.uniform(-1, 1, (4, 5, 3, 3))).astype(np.float32)
    for mixing in (Mixing(), Mixing(None, pixel)):
        shared = mixing.shared(share)
        # rounding to float32
        np.testing.assert_allclose(shared.unmixed(light), share[..., None] * mixing.unmixed(light), rtol=1e-5)
        np.testing.assert_allclose(shared.seen(shared.unmixed(light)), light, rtol=1e-5)


def test_a_room_is_played_with_its_shares(tmp_path: Path, rng: np.random.Generator) -> None:
    """The drive gets half of the target, T⁺ b while nothing clips. The predicted picture stays the same."""
    write_blurred_room(tmp_path / "room", rng, (11, 17), (7, 13))
    assert build_correction_map.main([str(tmp_path / "room")]) == 0
    room, frame = read_room(tmp_path / "room", 0.01), yuv_frame(rng, (9, 15))
    dark = replace(room.calibration, ambient=np.zeros_like(room.calibration.ambient))
    share = np.full(dark.camera.shape, 0.5, np.float32)
    found = []
    for drift in (None, Drift((moved_by(0, 0),), share=share)):
        renderer = CpuRenderer(replace(room, calibration=dark, drift=drift))
        renderer.open(frame.format)
        renderer.upload(frame)
        renderer.render("projector", compensate=True)
        found.append([renderer.linear().copy()])
        renderer.render("camera", compensate=True)
        found[-1].append(renderer.linear().copy())
        renderer.release()
    (drive, seen), (less, same) = found
    assert 0 < drive.max() < 1
    np.testing.assert_allclose(less, drive / 2, rtol=1e-5, atol=1e-9)  # rounding to float32
    np.testing.assert_allclose(same, seen, rtol=1e-5, atol=1e-9)

"""A room whose rows of T were scaled after calibration shows better frames without steps, if the factors are known."""

import numpy as np

from counterlight.media.frames import radiance_frame
from counterlight.pipeline.correction import Correction
from counterlight.pipeline.cpu_renderer import CpuRenderer
from counterlight.pipeline.drift import Moved
from tests.refined_rooms import physical_room

LEFT = 0.1  # of the added squared error: the damped T⁺ is not exact


def test_frames_without_steps_improve_in_a_room_whose_rows_were_scaled(rng: np.random.Generator) -> None:
    """The true room is c = g ∘ (T p + e), with dense T."""
    made = physical_room(rng)
    e, inside = made.room.ambient.reshape(-1, 3), made.inside
    camera = made.room.calibration.camera.shape
    y, x = np.mgrid[: camera[0], : camera[1]]
    soft = np.exp(-((y - 5) ** 2 + (x - 8) ** 2) / 18)[..., None]
    gains = (1 - soft * (0.2, 0.3, 0.1)).astype(np.float32)
    full = np.einsum("kcp,pk->ck", made.dense, np.ones((made.dense.shape[2], 3)))
    share = 0.45 + 0.1 * np.sin(0.5 * x + 0.4 * y).reshape(-1, 1)
    wanted = e + share * full
    renderer, frame = CpuRenderer(made.room), radiance_frame(wanted.reshape(*camera, 3))
    renderer.open(frame.format)
    renderer.upload(frame)
    ones = np.ones_like(gains)
    errors = []
    for true, given in ((ones, None), (gains, None), (gains, gains)):
        renderer.correct(Correction((Moved.nothing(),), row_gains=given))
        renderer.render("projector", compensate=True, steps=0)
        p = renderer.linear().reshape(-1, 3).astype(np.float64)
        seen = true.reshape(-1, 3) * (np.einsum("kcp,pk->ck", made.dense, p) + e)
        errors.append(float(np.mean((seen - wanted)[inside] ** 2)))
    calibrated, stale, corrected = errors
    assert corrected - calibrated < LEFT * (stale - calibrated)

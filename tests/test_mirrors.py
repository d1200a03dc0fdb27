"""Mirrors: what a camera sees or a projector lights by a mirror equals the result of the mirrored device."""

from pathlib import Path

import numpy as np
import pytest

from counterlight.tools.simulation.simulate import simulate
from counterlight.tools.transport.transport import channels
from tests.test_optics import at, room

MIRROR = """
[[surfaces]]
name = "mirror"
corner = [-1, -1, 0]
edge_u = [0, 0, 2]
edge_v = [0, 2, 0]
albedo = [0, 0, 0]
gloss = { reflectance = 1, roughness = 0 }
"""
CARD = """
[[surfaces]]
name = "card"
corner = [0, -0.6, 0]
edge_u = [1.2, 0, -0.2]
edge_v = [0, 1.2, 0]
pattern = { kind = "checker", colours = [[0.8, 0.7, 0.6], [0.2, 0.3, 0.4]], repeat = [5, 7] }
"""


def test_a_mirror_shows_what_a_mirrored_camera_sees(tmp_path: Path) -> None:
    """The mirror is the plane x = −1. The camera looks into the mirror and sees the card behind itself."""
    lamp = at([1.5, 0.2, 3], [0.6, 0, 0])
    real = room(tmp_path, MIRROR + CARD, lamp, at([0.8, 0.1, 2.5], [-2.6, 0, -0.1]))
    virtual = room(tmp_path, CARD, lamp, at([-2.8, 0.1, 2.5], [0.6, 0, -0.1]))
    only = ["direct", "shadows", "gloss"]  # only projector light that falls straight onto the card
    seen, expected = (simulate(s, only=only).transport.composition().reshape(18, 24, 3) for s in (real, virtual))
    lit = expected.max(axis=2) > 0
    assert lit.mean() > 0.3
    # float32; rays are the same in both scenes
    np.testing.assert_allclose(seen, expected[:, ::-1], rtol=1e-4, atol=1e-6)


def test_a_mirror_lights_as_a_mirrored_projector_would(tmp_path: Path) -> None:
    eye = at([0.8, 0.1, 2.5], [0.6, 0, -0.1])
    real = room(tmp_path, MIRROR + CARD, at([0.8, 0.1, 2.5], [-2.6, 0, -0.1]), eye, (48, 36))
    virtual = room(tmp_path, CARD, at([-2.8, 0.1, 2.5], [0.6, 0, -0.1]), eye, (48, 36))
    drive = np.zeros((36, 48, 3))
    drive[10:26, 14:34] = 1
    pictures = []
    for scene, picture in ((real, drive[:, ::-1]), (virtual, drive)):
        T = channels(simulate(scene, only=["direct", "shadows", "caustics", "gloss"]).transport.near)
        pictures.append(np.stack([T[i] @ picture[..., i].ravel() for i in range(3)], axis=1))
    seen, expected = (picture.reshape(9, 4, 12, 4, 3).mean(axis=(1, 3)) for picture in pictures)
    assert expected.max() > 0.3
    np.testing.assert_allclose(seen, expected, atol=0.08 * expected.max())  # the light map blurs edges by half a pixel
    assert seen.sum() == pytest.approx(expected.sum(), rel=0.01)

"""Far light whose cells gather more pixels than a texture row holds, computed in parts with the same result."""

from pathlib import Path

import moderngl
import numpy as np
import pytest

from counterlight import calibration
from counterlight.media.frames import radiance_frame
from counterlight.pipeline.device import GpuPath
from counterlight.pipeline.room import Room, read_room
from counterlight.tools.inverse import refinement_maps
from counterlight.tools.inverse.build import build_room_maps
from counterlight.tools.inverse.near_light import InverseOptions
from tests.renderers import both
from tests.rooms import write_blurred_room

CAMERA, PROJECTOR, CELLS = (9, 14), (6, 8), 3
NARROW = 7  # texels: cells gather 48 and up to 126 pixels
ATOL = 2e-5  # float32 sums of 126 terms in another order, over eight steps


def built(folder: Path) -> Room:
    write_blurred_room(folder, np.random.default_rng(3), CAMERA, PROJECTOR, CELLS)
    build_room_maps(calibration.read(folder), InverseOptions(0.1))
    return read_room(folder, None, words=True)


@pytest.mark.parametrize("path", [GpuPath(), GpuPath(entries="words"), GpuPath("compute")], ids=str)
def test_cells_in_parts_give_what_whole_ones_give(
    gl_context: moderngl.Context, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, path: GpuPath
) -> None:
    whole = built(tmp_path / "whole")
    monkeypatch.setattr(refinement_maps, "MAX_TEXTURE_WIDTH", NARROW)
    room = built(tmp_path / "room")
    assert room.maps.words is not None
    for name in ("far", "undo", "dual"):
        gather, mix = (room.maps.named()[f"{name}_{part}"] for part in ("gather", "mix"))
        assert gather.lookup[..., 2].max() <= NARROW
        assert gather.output_shape == mix.source_shape
        assert mix.source_shape[1] > mix.output_shape[1] == CELLS
    rng = np.random.default_rng(5)
    frame = radiance_frame(rng.choice([0.02, 0.3, 0.9], (*CAMERA, 3)).astype(np.float32))
    drives = []
    for each in (whole, room):
        with both(gl_context, each, frame, path) as (gl, cpu):
            for steps, view in ((0, "projector"), (8, "projector"), (8, "camera")):
                for renderer in (gl, cpu):
                    renderer.render(view, compensate=True, steps=steps)
                if path.entries != "words":  # words have the same numbers in entries on the CPU
                    np.testing.assert_allclose(gl.linear(), cpu.linear(), atol=ATOL)
                drives.append(gl.linear())
    for expected, found in zip(drives[:3], drives[3:], strict=True):
        assert expected.std() > 0.01
        np.testing.assert_allclose(found, expected, atol=ATOL)

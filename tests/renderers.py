"""A room's renderers on the GPU and in numpy, and the content of textures."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import moderngl
import numpy as np

from counterlight.gl.renderer import GlRenderer
from counterlight.media.frames import radiance_frame
from counterlight.media.video import Frame
from counterlight.pipeline.cpu_renderer import CpuRenderer
from counterlight.pipeline.device import EVERYWHERE, GpuPath
from counterlight.pipeline.reference_renderer import ReferenceRenderer
from counterlight.pipeline.room import Room
from counterlight.pipeline.shortfall import Snapshot


@contextmanager
def both(
    context: moderngl.Context, room: Room, frame: Frame, path: GpuPath = EVERYWHERE
) -> Iterator[tuple[GlRenderer, ReferenceRenderer]]:
    """Yield both renderers with `frame` uploaded; release them at the end."""
    renderers = GlRenderer(context, room, path), ReferenceRenderer(room)
    try:
        for renderer in renderers:
            renderer.open(frame.format)
            renderer.upload(frame)
        yield renderers
    finally:
        renderers[0].release()


def read(texture: moderngl.Texture, dtype: type = np.float32) -> np.ndarray:
    """Colours (height, width, 3) of a texture with four channels."""
    return np.frombuffer(texture.read(), dtype).reshape(texture.height, texture.width, 4)[..., :3]


def drawn(room: Room, picture: np.ndarray, start: str, steps: int) -> tuple[Snapshot, np.ndarray]:
    """Snapshot of a radiance picture after `steps` steps, and b, (camera pixels, 3)."""
    renderer, frame = CpuRenderer(replace(room, start=start)), radiance_frame(picture)
    renderer.open(frame.format)
    renderer.upload(frame)
    renderer.render("projector", compensate=True, steps=steps)
    found = renderer.snapshot()
    assert found is not None
    return found, (renderer.desired() - room.ambient).reshape(-1, 3).astype(float)
